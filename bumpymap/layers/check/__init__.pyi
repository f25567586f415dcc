from .record import (
    CHECK_MANIFEST_NAME as CHECK_MANIFEST_NAME,
    CHECK_NAMES as CHECK_NAMES,
    CHECK_VIEW_NAMES as CHECK_VIEW_NAMES,
    check_check_out as check_check_out,
    read_check as read_check,
)
