from .classifier import (
    ScanClassifier as ScanClassifier,
    ScanResult as ScanResult,
    classify_scan as classify_scan,
)
from .config import (
    ScanConfig as ScanConfig,
)
from .learned import (
    CHANNELS as CHANNELS,
    MEASURES as MEASURES,
    SECTOR_VERSION as SECTOR_VERSION,
    ScanModel as ScanModel,
    classify_learned as classify_learned,
    network_input as network_input,
)
from .pipeline import (
    ScanRun as ScanRun,
    scan_frames as scan_frames,
)
from .sectors import (
    polar_sectors as polar_sectors,
)
from .stripes import (
    StripeModel as StripeModel,
    classify_filter as classify_filter,
    load_stripes as load_stripes,
)
