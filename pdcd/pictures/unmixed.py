"""Direct light that gets into a photo of indirect light, taken out.

Slow panels, and black that is not black, let a share r of the direct light through: so says the
realised probing matrix, quad by quad. A white photo is W = D + I, the coded one C = I + r D, both
over their weights. So I = (C - r W) / (1 - r).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.weights import Weights, brought
from pdcd.probing.realised import Factors
from pdcd.sensor.bands import in_bands, planar
from pdcd.sensor.cells import CellMap

Floats = NDArray[np.float64]
Errors = NDArray[np.floating]

LEAST = 1e-4
"""Share of the direct light below which none is taken out: nobody could see it."""
MOST = 0.5
"""Share from which the photo tells too little of indirect light to be mended so."""


def direct_share(realised: Factors, weights: Weights, cells: CellMap) -> Floats | None:
    """Share of the direct light that a photo of indirect light has, (h, w); None where it is not
    worth a correction, or beyond one."""
    level = float(np.mean(weights.quads_s))
    largest = float(np.abs(realised.coaxial).max()) / level
    if not LEAST < largest < MOST:
        return None
    fine = None if cells.map is None else realised.fine
    if fine is None:
        seen = brought(realised.coaxial, cells, None)
    else:
        seen = cells.gather(fine.coaxial, fine.cuts)
    share = seen / weights.quads_s
    return share if float(np.abs(share).max()) < MOST else None


def unmixed(
    image: Floats, sigma: Errors, white: Floats, of_white: Errors, share: Floats
) -> tuple[Floats, Errors]:
    """A photo of indirect light and its error bar, (h, w, 3) each, without that direct light.

    white, of_white : the white photo and its error bar; where nothing is known of it the photo
    stays as it is. share : (h, w) of the direct light that the photo has.
    """
    out, error = planar(image.shape), planar(sigma.shape, sigma.dtype)

    def band(rows: slice) -> None:
        known = np.isfinite(of_white[rows])
        r = np.where(known, share[rows, :, None], 0.0)
        out[rows] = (image[rows] - r * white[rows]) / (1.0 - r)
        noise = r * np.where(known, of_white[rows], 0.0)
        error[rows] = np.hypot(sigma[rows], noise) / (1.0 - r)

    in_bands(image.shape[0], band)
    return out, error
