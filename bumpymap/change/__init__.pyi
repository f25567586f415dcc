from .pipeline import ChangeResult as ChangeResult, diff_surveys as diff_surveys, find_changes as find_changes
