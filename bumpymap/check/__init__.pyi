from .pipeline import check_drives as check_drives, run_check as run_check
