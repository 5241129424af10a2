"""Panels that lie elsewhere, found in pictures that are sampled here, point by point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy
from numpy.typing import NDArray

from pdcd.bench.placed import map_to_field
from pdcd.bench.tables import PanelConfig
from pdcd.panels.blocks import BlockPattern
from pdcd.panels.map import Map
from pdcd.pictures.lost_direct import estimate_lost_by_quad, estimate_lost_direct
from pdcd.pictures.misplaced import (
    BlockPhotos,
    field_shifts_px,
    find_panel_places,
    interpolate_bend_px,
    make_affine_map,
    measure_misplacement,
)
from pdcd.runs.record import PanelLook
from pdcd.sensor.cells import CellMap

pytestmark = pytest.mark.whole

Floats = NDArray[np.float64]

WIDTH, HEIGHT = 512, 384
PROJECTOR, MASK, QUADS = (WIDTH, HEIGHT), (800, 600), (128, 96)
SIZE: Any = np.array(PROJECTOR)
MIDDLE = SIZE / 2.0
POINTS = 6
"""Along either axis of a quad."""


class Lies:
    """A picture that is mirrored, then turned about the middle, enlarged, shifted."""

    def __init__(
        self,
        offset: tuple[float, float] = (0.0, 0.0),
        turn: float = 0.0,
        scale: float = 1.0,
        flip: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        angle = np.radians(turn)
        turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        self.linear = scale * turned * np.array(flip)
        self.shift = MIDDLE + offset - self.linear @ MIDDLE

    def lies(self, drawn: Floats) -> Floats:
        return np.asarray(drawn @ self.linear.T + self.shift)

    def drawn(self, lies: Floats) -> Floats:
        return np.asarray((lies - self.shift) @ np.linalg.inv(self.linear).T)


class Bent(Lies):
    """As a lens bends it: the further from the middle, the more it lies outwards, or inwards."""

    def __init__(self, radial: float) -> None:
        super().__init__()
        self.radial = radial

    def lies(self, drawn: Floats) -> Floats:
        away = (drawn - MIDDLE) / MIDDLE[0]
        bend = self.radial * np.sum(away**2, axis=-1, keepdims=True)
        return np.asarray(drawn + bend * (drawn - MIDDLE))

    def drawn(self, lies: Floats) -> Floats:
        found = lies
        for _ in range(20):
            found = found + lies - self.lies(found)
        return found


def seen(
    blocks: BlockPattern,
    panel: tuple[int, int],
    lies: Lies,
    camera: Lies,
    blur: Sequence[tuple[float, float]] = ((1.0, 0.0),),
) -> Floats:
    """What quads see of the blocks on a panel, (h, w): its pixels are drawn one by one. blur :
    shares of the light, and by how many projector pixels each is blurred."""
    width, height = QUADS
    x, y = ((np.arange(n * POINTS) + 0.5) / (n * POINTS) for n in (width, height))
    at = camera.lies(np.stack(np.meshgrid(x, y), axis=-1) * SIZE)
    share = lies.drawn(at) / SIZE
    pixel = np.floor(share * panel)
    on = np.all((pixel >= 0) & (pixel < panel), axis=-1)
    centre = (pixel + 0.5) / panel
    block = np.clip(np.floor(centre * (blocks.cols, blocks.rows)), 0, None).astype(int)
    block = np.minimum(block, (blocks.cols - 1, blocks.rows - 1))
    lit = np.where(on, blocks.bits[block[..., 1], block[..., 0]], 0.0)
    step = WIDTH / (width * POINTS)
    lit = sum(share * scipy.ndimage.gaussian_filter(lit, px / step) for share, px in blur)
    return np.asarray(lit.reshape(height, POINTS, width, POINTS).mean(axis=(1, 3)))


def looked(
    mask: Lies,
    camera: Lies | None = None,
    direct: float = 0.6,
    electrons: float = 5000.0,
    mirror: bool = False,
    projector: PanelConfig | None = None,
    blur: Sequence[tuple[float, float]] = ((1.0, 0.0),),
    lens_px: float = 0.0,
) -> PanelLook:
    """A look at a textured scene with that share of direct light, through all its noise. mirror :
    other light is that of the mirrored place, and not of all places. projector : whose field this
    is; None: it has its whole picture. blur : of light before the mask, as shares of it with so
    many projector pixels each. lens_px : of the camera."""
    random = np.random.default_rng(3)
    blocks = BlockPattern.of((PROJECTOR, MASK), WIDTH / QUADS[0])
    assert blocks is not None
    camera = camera or Lies()
    texture = electrons * np.exp(0.6 * random.normal(size=QUADS[::-1]))
    before = [(share, float(np.hypot(px, lens_px))) for share, px in blur]
    here = seen(blocks, PROJECTOR, Lies(), camera, before)
    first = direct * here + (1.0 - direct) * (here[:, ::-1] if mirror else 0.5)
    second = seen(blocks, MASK, mask, camera, [(1.0, lens_px)])
    white, one, other = (
        random.poisson(texture * share).astype(np.float64) for share in (1.0, first, second)
    )
    photos = BlockPhotos(white=white, projector=one, mask=other, known=white < 8.0 * electrons)
    projector = projector or PanelConfig(size_px=PROJECTOR)
    maps = map_to_field(Map.filling(projector.size_px), projector), Map.filling(MASK)
    return find_panel_places(photos, blocks, Map.filling(QUADS), maps, projector.field_size_px)


def test_places_are_in_pixels_of_a_projector_of_whose_picture_the_field_is_a_part() -> None:
    """Of 1024 x 768 pixels the field has the middle 512 x 384."""
    larger = PanelConfig(size_px=(2 * WIDTH, 2 * HEIGHT), field_px=(256, 192, WIDTH, HEIGHT))
    found = looked(Lies((24.0, 3.0)), projector=larger)
    assert found.mask is not None
    assert (
        np.hypot(*(make_affine_map(found.mask)(MIDDLE) - MIDDLE - (24.0, 3.0)))
        < 0.1 * WIDTH / QUADS[0]
    )


@pytest.mark.parametrize(
    "mask",
    [
        Lies(),
        Lies((-31.0, 32.0)),
        Lies((30.0, 0.0), turn=3.0, scale=0.8, flip=(-1.0, 1.0)),
    ],
)
def test_a_mask_is_found_to_a_tenth_of_a_quad(mask: Lies) -> None:
    found = looked(mask)
    assert found.mask is not None and found.mask_seen
    where = make_affine_map(found.mask)
    right, down = where(MIDDLE) - mask.lies(MIDDLE)
    assert np.hypot(right, down) < 0.1 * WIDTH / QUADS[0]
    corners = np.array([(0.0, 0.0), (WIDTH, 0.0), (0.0, HEIGHT), (WIDTH, HEIGHT)])
    inner = MIDDLE + 0.8 * (corners - MIDDLE)
    assert np.hypot(*(where(inner) - mask.lies(inner)).T).max() < 0.5 * WIDTH / QUADS[0]
    assert abs(found.direct - 0.6) < 0.08
    assert found.upright == bool(np.linalg.det(mask.linear) > 0.0)


@pytest.mark.parametrize("radial", [-0.04, 0.0, 0.05])
def test_a_bent_mask_is_found_all_over(radial: float) -> None:
    """Up to 16 projector pixels in the corners, of which an affine map explains half."""
    mask = Bent(radial)
    found = looked(mask)
    assert found.mask is not None and (found.bent_px is None) == (radial == 0.0)
    along = (np.arange(9) + 0.5) / 9.0
    places = np.stack(np.meshgrid(along * WIDTH, along * HEIGHT), axis=-1).reshape(-1, 2)
    off = field_shifts_px(found.mask, PROJECTOR, bent_px=found.bent_px)
    wrong = np.hypot(*(off - (mask.lies(places) - places)).T)
    assert np.sqrt(np.mean(wrong**2)) < 0.25 * WIDTH / QUADS[0]
    at = interpolate_bend_px(found, places / SIZE)
    assert np.allclose(at, 0.0 if found.bent_px is None else found.bent_px)


def test_a_look_says_how_sure_it_is() -> None:
    """It is off by less than three of its standard deviations, which are larger by noisy photos."""
    sigmas = []
    for electrons in (5000.0, 50.0):
        found = looked(Lies((2.0, 0.0)), electrons=electrons)
        assert found.mask is not None
        off = field_shifts_px(found.mask, PROJECTOR, (2.0, 0.0))
        error = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        assert error < 3.0 * found.sigma_px
        sigmas.append(found.sigma_px)
    assert 0.0 < sigmas[0] < sigmas[1] < 0.1 * WIDTH / QUADS[0]


@pytest.mark.parametrize(
    "camera", [Lies((12.0, -5.0), turn=-2.0, scale=1.1), Lies(flip=(-1.0, 1.0))]
)
def test_the_camera_cancels_and_is_found_by_itself(camera: Lies) -> None:
    found = looked(Lies((5.0, 0.0)), camera)
    assert found.mask is not None and found.camera is not None
    quad_px = WIDTH / QUADS[0]
    on_mask, on_camera = make_affine_map(found.mask), make_affine_map(found.camera)
    assert np.hypot(*(on_mask(MIDDLE) - MIDDLE - (5.0, 0.0))) < 0.12 * quad_px
    assert np.hypot(*(on_camera(MIDDLE) - camera.lies(MIDDLE))) < 0.2 * quad_px
    lie = measure_misplacement(found.camera, PROJECTOR)
    assert lie.flip == ("horizontal" if camera.linear[0, 0] < 0.0 else "none")


def test_little_direct_light_is_enough_and_none_is_said() -> None:
    faint = looked(Lies((10.0, 0.0)), direct=0.1)
    assert faint.mask is not None
    assert abs(make_affine_map(faint.mask)(MIDDLE)[0] - MIDDLE[0] - 10.0) < 0.2 * WIDTH / QUADS[0]
    none = looked(Lies((10.0, 0.0)), direct=0.0)
    assert none.mask is None and none.mask_seen and none.direct == 0.0


@pytest.mark.parametrize("lens_px", [0.0, 3.0])
@pytest.mark.parametrize("blur_px", [0.0, 2.5, 4.0, 8.0, 14.0])
def test_a_blur_of_light_before_the_mask_is_told_from_that_of_the_lens(
    blur_px: float, lens_px: float
) -> None:
    found = looked(Lies(), blur=[(1.0, blur_px)], lens_px=lens_px)
    assert found.blur_px == pytest.approx(blur_px, rel=0.25 if blur_px < 4.0 else 0.1)
    assert found.direct == pytest.approx(0.6, abs=0.05)


@pytest.mark.parametrize("mask", [Lies(), Lies((-11.0, 5.0), turn=3.0, scale=0.9)])
def test_a_blur_is_found_through_a_mask_that_lies_elsewhere(mask: Lies) -> None:
    assert looked(mask, blur=[(1.0, 8.0)]).blur_px == pytest.approx(8.0, rel=0.1)
    assert looked(mask).blur_px == 0.0


@pytest.mark.parametrize("wide_px", [4.0, 8.0, 30.0])
def test_a_scene_that_scatters_half_of_its_light_has_no_blur(wide_px: float) -> None:
    assert looked(Lies(), blur=[(0.5, 0.0), (0.5, wide_px)]).blur_px == 0.0


def test_a_mirror_in_the_scene_is_not_taken_for_a_mirrored_panel() -> None:
    """Nine tenths of the projector's light come from the mirrored place: as much as hides the rest.
    With half of it the panel is found where it is."""
    nine_tenths = looked(Lies(), direct=0.1, mirror=True)
    assert nine_tenths.mask is None and nine_tenths.mask_seen
    half = looked(Lies(), direct=0.5, mirror=True)
    assert half.upright


def test_how_a_picture_lies_in_words_terms() -> None:
    lies = Lies((30.0, -4.0), turn=3.0, scale=0.8, flip=(1.0, -1.0))
    (a, b), (d, e) = lies.linear.tolist()
    lie = measure_misplacement((a, b, float(lies.shift[0]), d, e, float(lies.shift[1])), PROJECTOR)
    assert lie.flip == "vertical"
    assert (lie.turn_deg, lie.scale, *lie.offset_px) == pytest.approx((3.0, 0.8, 30.0, -4.0))
    shifted = measure_misplacement((1.0, 0.0, 3.0, 0.0, 1.0, 4.0), PROJECTOR)
    assert (shifted.flip, shifted.median_px, shifted.most_px) == ("none", 5.0, 5.0)
    assert field_shifts_px((1.0, 0.0, 3.0, 0.0, 1.0, 4.0), PROJECTOR, (3.0, 4.0)).max() == 0.0


def run(look: PanelLook | None, **mask: Any) -> Any:
    """What a run remembers, of cells of 16 px and a camera with quads of a pixel."""

    class Cells:
        filled = Map.filling(PROJECTOR)

    class Run:
        panels, grid, cells = look, (24, 32), Cells
        projector = PanelConfig(size_px=PROJECTOR)

    made: Any = Run
    made.mask = PanelConfig(size_px=MASK, **mask)
    return made


def moved(right: float, down: float) -> PanelLook:
    return PanelLook(
        mask=(1.0, 0.0, right, 0.0, 1.0, down), camera=None, rest_px=0.0, direct=0.5, mask_seen=True
    )


def test_what_a_look_cannot_be_sure_of_loses_no_light() -> None:
    """A mask 1.4 px off counts where that is seen to 0.1 px, and not where it is seen to 0.5."""
    look = moved(1.4, 0.0)
    assert estimate_lost_direct(run(look), "whole").mean > 0.05
    assert (
        estimate_lost_direct(run(msgspec.structs.replace(look, sigma_px=0.5)), "whole").mean == 0.0
    )


def test_direct_light_lost_through_whole_cells_is_that_of_the_strip_beside_them() -> None:
    """Of a cell of 16 px that is 4.1 px off, 4.1 less a tenth that counts as none, a quarter sees
    its neighbour; through quads of a pixel its root mean square is nearly the root of that."""
    lost = estimate_lost_direct(run(moved(4.1, 0.0)), "whole")
    assert lost.mean == pytest.approx(0.25, abs=1e-9)
    assert lost.rms == pytest.approx(0.5, rel=0.05)
    inside = estimate_lost_direct(run(moved(3.9, 0.0)), "quarter")
    assert inside.mean == pytest.approx(0.0, abs=1e-9) and inside.rms < 1e-3
    assert estimate_lost_direct(run(moved(40.0, 0.0)), "quarter").mean == pytest.approx(1.0)


@pytest.mark.parametrize(("window", "guard"), [("whole", 0), ("quarter", 4)])
def test_direct_light_is_lost_where_cells_of_light_and_mask_meet_otherwise(
    window: str, guard: int
) -> None:
    """A mask 7 px to the right: pixel by pixel, which cell is lit and which is open there."""
    cells = CellMap(grid=(24, 32), frame=(HEIGHT, WIDTH), map=Map.filling(PROJECTOR))
    light, lost = np.arange(WIDTH), np.zeros(WIDTH, np.bool_)
    for moved_px in (0, 8) if guard else (0,):
        place, drawn = light + moved_px, light - 7 + moved_px
        is_open = (drawn % 16 >= guard) & (drawn % 16 < 16 - guard)
        lost |= is_open & (place // 16 != drawn // 16)
    look = moved(7.0, 0.0)
    assert look.mask is not None
    found = estimate_lost_by_quad(run(look), look, look.mask, window, cells)[8]
    assert 0.1 < lost.mean() < 0.5
    near = np.convolve(lost, np.ones(5), "same")[16:-16]
    assert found[16:-16][lost[16:-16]].min() > 0.8
    assert found[16:-16][near == 0].max() < 0.1


def test_what_is_known_or_not_found_loses_nothing() -> None:
    for one in (run(None), run(moved(0.05, 0.05)), run(moved(-3.0, 1.0), offset_px=(3.0, -1.0))):
        lost = estimate_lost_direct(one, "whole")
        assert (lost.mean, lost.rms) == (0.0, 0.0)


def test_a_mirrored_mask_loses_all() -> None:
    look = PanelLook(
        mask=(-1.0, 0.0, float(WIDTH), 0.0, 1.0, 0.0), camera=None, rest_px=0.0, direct=0.5,
        mask_seen=True,
    )  # fmt: skip
    assert estimate_lost_direct(run(look), "quarter").mean == 1.0
