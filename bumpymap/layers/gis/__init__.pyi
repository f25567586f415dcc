from .project import (
    write_project as write_project,
)
from .styles import (
    write_styles as write_styles,
)
