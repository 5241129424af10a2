"""What the camera sees of the field: looked at before the first exposure, and photo by photo.

A photo that cannot be decoded is not worth the ones after it. So a frame that is known beforehand
is held against the field before there is light, any other one as soon as the first photo is there;
and every photo of a run must be of the same size, orientation and camera.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from pdcd.bench.devices import CameraInfo, Finding, fault
from pdcd.bench.placed import camera_map
from pdcd.bench.tables import Config
from pdcd.capture.job import Journal
from pdcd.capture.same_bench import held_otherwise
from pdcd.errors import ExposureError, PdcdError
from pdcd.sensor.fit import check_fit, fit_of
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import RawHead, read_head


@dataclass
class FrameCheck:
    """The camera's frame in one run. grid : rows and columns of its cells. cut : whether any shot
    opens less than whole cells. None of both is known before there is a plan."""

    config: Config
    camera: CameraInfo
    journal: Journal
    grid: tuple[int, int] | None = None
    cut: bool = False
    _first: tuple[str, RawHead] | None = field(default=None, init=False)

    def foresee(self, grid: tuple[int, int], *, cut: bool) -> None:
        """Hold the frame that the camera tells of against the cells of a plan.

        Nothing is said of a camera that tells none. Raises ConfigError.
        """
        self.grid, self.cut = grid, cut
        if self.camera.frame_quads is not None:
            width, height = self.camera.frame_quads
            self._check((height, width))

    def saw(self, file: str, head: RawHead) -> None:
        """One more photo came. Raises ConfigError when the first one does not fit the field, and
        ExposureError for one that is unlike the first."""
        if self._first is None:
            told = self.camera.frame_quads
            if told is not None and told != head.frame[::-1]:
                self.journal.warn(
                    f"photos have {_size(head)} quads, not the {told[0]} x {told[1]} that were "
                    "expected of this camera: is it set to full-size RAW?"
                )
            self._check(head.frame)
            if held_otherwise(self.config, head.flip):
                self.journal.warn(
                    "the camera is held another way than when it was calibrated: calibrate geometry"
                )
            self._first = file, head
            return
        before, first = self._first
        for what, now, then in (
            ("quads", _size(head), _size(first)),
            ("orientation", head.turned, first.turned),
            ("camera", head.model or "unnamed", first.model or "unnamed"),
        ):
            if now != then:
                raise ExposureError(
                    f"{file} is unlike {before}: {what} {now}, not {then}",
                    device="camera",
                    hint="leave camera and settings alone during a run; switch off its rotation "
                    "of pictures",
                )

    def _check(self, frame: tuple[int, int]) -> None:
        if self.grid is not None:
            check_frame(self.config, frame, self.grid, cut=self.cut)


def check_frame(
    config: Config, frame: tuple[int, int], grid: tuple[int, int], *, cut: bool
) -> None:
    """Hold a frame of so many rows and columns of quads against the cells of a grid; `cut` is that
    of a plan (`Plan.cut`).

    Raises ConfigError when the camera's place is no sound map, or the frame does not fit.
    """
    check_fit(fit_of(camera_map(config, frame), grid), "quarter" if cut else "whole")


def examine(config: Config, raw: Path | None) -> Iterator[Finding]:
    """Yield what is known of the camera's frame: from a RAW file, else from the sensor profile.

    What fails is a finding, too.
    """
    what = "frame"
    try:
        if raw is None:
            told = load_profile(config.camera.profile).frame_quads
            if told is None:
                yield Finding(
                    "frame", "unknown", "not told by the sensor profile", "give a photo: --raw FILE"
                )
                return
            frame = told[1], told[0]
            yield Finding("frame", "good", f"{told[0]} x {told[1]} quads, by the sensor profile")
            yield Finding("orientation", "unknown", "only a photo tells", "give one: --raw FILE")
        else:
            head = read_head(raw)
            frame = head.frame
            yield Finding("frame", "good", f"{_size(head)} quads, of {head.model or raw.name}")
            yield Finding("orientation", "good", f"{head.turned}; not followed, see [camera.place]")
            rows, columns = head.masked
            border = f"{rows} rows and {columns} columns beyond the picture"
            yield Finding("masked border", "good", border if rows + columns else "none")
        what, grid = "view of the field", config.code_grid()
        fit = fit_of(camera_map(config, frame), grid)
        seen = f"{100.0 * fit.seen:.3g} % of {grid[0]} x {grid[1]} cells"
        yield Finding("field seen", "good", seen)
        low, high = fit.across
        yield Finding("quads along a cell's side", "good", f"{low:.3g} to {high:.3g}")
        window = config.schedule.window
        check_fit(fit, "whole" if window == "whole" else "quarter")
    except PdcdError as err:
        yield fault(what, err, "camera")


def _size(head: RawHead) -> str:
    return f"{head.frame[1]} x {head.frame[0]}"
