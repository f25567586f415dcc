from .profile import (
    Vehicle as Vehicle,
    load_profile as load_profile,
)
