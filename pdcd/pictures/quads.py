"""Between the quads of a picture and its cells: error bars there and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.combine import Errors, Picture
from pdcd.pictures.sigma import Barred
from pdcd.pictures.smoothed import by_light
from pdcd.sensor.bands import in_bands, planar
from pdcd.sensor.cells import CellMap

Floats = NDArray[np.float64]


def of_cells(picture: Picture, cells: CellMap) -> Picture:
    """Means of a picture over cells, (rows, cols, 3) float64, and the error of these means by the
    errors of single quads; infinite where too little of a cell is known.

    Quads that are not known do not count, but where a cell is unknown it has the mean of all that
    see it, as they were measured. Cells that no quad sees are 0.
    """
    known = _known(picture, cells)
    image, sure = means(picture.image, known, cells)
    sigma = cells.error_of_mean(picture.sigma**2, known)
    sigma[~sure] = np.inf
    shape = *cells.grid, image.shape[1]
    return Picture(image.reshape(shape), sigma.reshape(shape))


def image_of_cells(picture: Picture, cells: CellMap) -> Floats:
    """The means of `of_cells` alone, which has half of the work."""
    image, _ = means(picture.image, _known(picture, cells), cells)
    return image.reshape(*cells.grid, image.shape[1])


def cell_means(picture: Barred, cells: CellMap) -> Barred:
    """The same of a picture with its whole error: (rows, cols, 3) float64 each.

    The sensor's part gets less by averaging. The error of the codes does not: quads of a cell share
    it, but for what `Barred.of_cells` knows.
    """
    coarse = of_cells(Picture(picture.image, picture.sensor), cells)
    code = picture.of_cells
    if code is None:
        code, _ = means(picture.code, _known(picture, cells), cells)
        code = code.reshape(coarse.image.shape)
    sigma = np.hypot(coarse.sigma, code)
    return Barred(coarse.image, sigma, coarse.sigma, code, picture.kind)


def shared_out(error: Errors, picture: Picture, coarse: Picture, cells: CellMap) -> Errors:
    """Errors of cells (rows, cols, 3) -> of quads (h, w, 3), in proportion to the quads' light.

    picture, coarse : the same light on quads and on cells.
    """
    channels = range(error.shape[2])
    shares = [
        by_light(picture.image[..., c], coarse.image[..., c].ravel(), cells) for c in channels
    ]
    errors = [cells.smooth_rows(error[..., c].ravel()) for c in channels]
    out = planar(picture.sigma.shape, picture.sigma.dtype)

    def band(rows: slice) -> None:
        for channel, (share, brought) in enumerate(zip(shares, errors, strict=True)):
            np.multiply(share(rows), brought(rows), out=out[rows, :, channel], casting="same_kind")

    in_bands(out.shape[0], band)
    return out


def means(
    image: NDArray[np.floating], known: NDArray[np.bool_] | None, cells: CellMap
) -> tuple[Floats, NDArray[np.bool_]]:
    """Means of an image (h, w, C) over cells, (N, C), and which cells are known (N,).

    known : (h, w), quads that count where enough of a cell is left; None for all of the field.
    """
    sure = cells.seen(known)
    mean = cells.mean(image, known)
    if not sure.all():
        mean[~sure] = cells.mean(image)[~sure]
    return mean, sure


def _known(picture: Picture, cells: CellMap) -> NDArray[np.bool_] | None:
    """(h, w), quads known in all channels; None where these are all that the field has."""
    known = np.isfinite(picture.sigma[..., 0])
    for channel in range(1, picture.sigma.shape[2]):
        known &= np.isfinite(picture.sigma[..., channel])
    return None if np.array_equal(known, cells.known) else known
