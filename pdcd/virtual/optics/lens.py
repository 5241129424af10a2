"""What the lens does to a picture on its way to the sensor: blur, and light lost in the corners."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.virtual.optics.setting import OpticalSetting, compute_falloff, find_points_on_field

_REACH = 4.0
"""Standard deviations after which the blur is cut off."""
_Inside = Callable[[Floats], NDArray[np.bool_]]
_POINTS = 8
"""Points along either axis of a quad that measure how much of it lies in the field."""


class Lens:
    """The lens of a bench."""

    def __init__(self, setting: OpticalSetting) -> None:
        self._setting = setting

    def through(self, image: Floats) -> Floats:
        """What the sensor gets of a picture (rows, cols, 3): blurred and shaded.

        Outside the frame the outermost quads are repeated as far as the field reaches; beyond the
        field it is dark.
        """
        blur = self._setting.true.camera.blur_quads
        if blur:
            image = self._blurred(image)
        rows, cols = self._setting.frame
        shade = compute_falloff(self._setting.truth.camera.falloff, (cols, rows))
        return image if shade is None else image * shade[..., None]

    @cached_property
    def share(self) -> Floats | None:
        """Share of each quad's light, (rows, cols), that comes from the field, 0 to 1; None without
        a blur: then quads that lie in the field see nothing else."""
        return self.share_of(find_points_on_field)

    def share_of(self, inside_of: _Inside) -> Floats | None:
        """The same for a part of the field: `inside_of` says which points (..., 2) of the field lie
        in that part."""
        if not self._setting.true.camera.blur_quads:
            return None
        rows, cols = self._setting.frame
        at = self._lie(inside_of, np.arange(cols + 1.0), np.arange(rows + 1.0))
        corners = at[1:, 1:].astype(np.int8) + at[:-1, 1:] + at[1:, :-1] + at[:-1, :-1]
        inside = (corners == 4).astype(np.float64)
        middles = (np.arange(_POINTS) + 0.5) / _POINTS
        for row, col in np.argwhere((corners > 0) & (corners < 4)):
            inside[row, col] = self._lie(inside_of, col + middles, row + middles).mean()
        return self._blurred(inside[..., None])[..., 0]

    def _blurred(self, image: Floats) -> Floats:
        """A picture (rows, cols, C), blurred."""
        # Only a mock bench that blurs needs it; daemons of real benches should not load it.
        from scipy.ndimage import gaussian_filter

        blur, (rows, cols) = self._setting.true.camera.blur_quads, self._setting.frame
        reach = int(_REACH * blur + 0.5)
        wide = np.pad(image, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
        x, y = (np.arange(-reach, size + reach, dtype=np.float64) + 0.5 for size in (cols, rows))
        beyond = ~self._lie(find_points_on_field, x, y)
        beyond[reach : reach + rows, reach : reach + cols] = False
        wide[beyond] = 0.0
        found = gaussian_filter(wide, (blur, blur, 0.0), mode="constant", truncate=_REACH)
        return np.asarray(found[reach : reach + rows, reach : reach + cols])

    def _lie(self, inside_of: _Inside, x: Floats, y: Floats) -> NDArray[np.bool_]:
        """Which places of the frame lie in a part of the field, (y, x)."""
        return inside_of(self._setting.camera.to_field(np.stack(np.meshgrid(x, y), axis=-1)))
