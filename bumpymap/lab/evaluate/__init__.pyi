from .agreement import (
    confusion as confusion,
)
from .document import (
    REPORT as REPORT,
    number as number,
    percent as percent,
    report_text as report_text,
    section as section,
    table as table,
    write_document as write_document,
)
from .findings import (
    Findings as Findings,
)
from .pictures import (
    require_matplotlib as require_matplotlib,
)
from .report import (
    write_report as write_report,
)
from .run import (
    evaluate_library as evaluate_library,
    evaluate_survey as evaluate_survey,
)
from .settings import (
    EvaluateSettings as EvaluateSettings,
)
from .subject import (
    Subject as Subject,
)
from .survey import (
    open_readers as open_readers,
)
from .tables import (
    confusion_lines as confusion_lines,
)
from .timing import (
    peak_bytes as peak_bytes,
)
from .trial import (
    TrialOptions as TrialOptions,
)
