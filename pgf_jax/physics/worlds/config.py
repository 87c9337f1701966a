"""Names of the worlds; no MuJoCo here, since the command line reads them."""

from typing import Literal

WorldName = Literal["solid", "scene", "none"]
