from .profile import (
    VehicleProfile as VehicleProfile,
    load_profile as load_profile,
)
