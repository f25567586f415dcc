from .evaluate import (
    Evaluation as Evaluation,
    predict as predict,
)
from .make import (
    make_model as make_model,
)
from .model import (
    NetworkSettings as NetworkSettings,
)
from .onnx_graph import (
    OnnxGraph as OnnxGraph,
)
from .output import (
    MadeModel as MadeModel,
    model_files as model_files,
    model_metadata as model_metadata,
)
from .scan.data import (
    UNSEEN as UNSEEN,
    scene_scan as scene_scan,
)
from .score import (
    Score as Score,
    count_answers as count_answers,
    percent as percent,
    score_table as score_table,
)
from .train import (
    TrainSettings as TrainSettings,
)
from .training import (
    EpochData as EpochData,
    EpochReport as EpochReport,
    LoopSettings as LoopSettings,
    Training as Training,
)
