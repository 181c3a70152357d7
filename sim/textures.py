"""Convert pictures to Mitsuba textures."""

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray


def bitmap(picture: NDArray[np.float32], *, wrap: str = "repeat") -> dict[str, Any]:
    """Return a picture (H, W) as a Mitsuba texture, with row 0 at v = 1 and column 0 at u = 0."""
    upside_down = np.ascontiguousarray(picture[::-1, :, None])
    return {"type": "bitmap", "bitmap": mi.Bitmap(upside_down), "raw": True, "filter_type": "bilinear", "wrap_mode": wrap}
