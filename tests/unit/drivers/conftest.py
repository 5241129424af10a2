"""The rigs that tests of one device share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import pytest

from tests.ptp_rig import PtpRig


@pytest.fixture
def rig() -> Iterator[PtpRig]:
    """A virtual 450D and the drivers that use it, connected."""
    rig = PtpRig()
    rig.connect()
    yield rig
    rig.disconnect_quietly()


class RefusingFile:
    """An open file that takes no bytes, or loses them at the end."""

    def __init__(self, file: IO[Any], error: OSError, at_the_end: bool) -> None:
        self.file, self.error, self.at_the_end = file, error, at_the_end

    def __enter__(self) -> RefusingFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def write(self, data: bytes) -> int:
        if not self.at_the_end:
            raise self.error
        return len(data)

    def flush(self) -> None:
        raise self.error


@pytest.fixture
def refuse_writes(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Lets each new file be there, and refuse its bytes by that error."""
    whole_open = Path.open

    def refuse(error: OSError, at_the_end: bool = False) -> None:
        def opened(path: Path, mode: str = "r", *args: Any) -> Any:
            file = whole_open(path, mode, *args)
            return RefusingFile(file, error, at_the_end) if mode == "xb" else file

        monkeypatch.setattr(Path, "open", opened)

    return refuse
