"""One life of a daemon in a soak: photo after photo, an attack on most, the promises after each."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from random import Random

from pdcd.errors import PdcdError
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.verify import verify_run
from tests.soak import processes
from tests.soak.attacks import ATTACKS, Attack
from tests.soak.benches import Bench
from tests.soak.daemons import Daemon
from tests.soak.lapse import Lapse
from tests.soak.page import STOP_S, LivePage
from tests.soak.tally import Row, Tally

DARK_S, CLOSED_S = 1.0, 1.0
"""How long after the end of a job or of a process light may last on a machine that is this busy."""
HANGS_S = 8.0
"""The same where a process was stopped: it must first be found to hang."""
GONE_S = 20.0
"""How long processes may outlive a daemon that was killed: a guardian finishes its work first."""
SILENT_S = 2.0
"""Longest silence of the heart beat."""
SPARE = {"descriptors": 4, "threads": 3, "processes": 1}
"""How many more a daemon may hold in the end than after its first photo."""
WARM = 5
"""Photos after which a daemon has all descriptors, threads and processes it is going to hold."""
SETTLED = 100
"""Photos after which it has taken every kind of photo, and its memory is what it is going to be."""
ROOM = 25
"""Photos after which their folders are looked at and removed: the disk of a soak is small."""
GROWN_MIB = 16.0
"""How much may come and go in between: some photos take more than others."""
CALM, KILLS = 0.15, 0.9
"""Share of photos that are left in peace, and of attacks that are drawn among kills only."""
LONG, LONG_CALM = 2 * SETTLED, 0.75
"""A life of so many photos or more is ended by no attack, and more of it is left in peace: only
such a life shows how a daemon grows."""


class Photographer:
    """One photo in a thread of its own: its result, or why there is none."""

    def __init__(self, daemon: Daemon, request: CaptureRequest) -> None:
        self.result: CaptureResult | None = None
        self.why = ""
        self._daemon, self._request = daemon, request
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            with self._daemon.client() as client:
                self.result = client.capture(self._request, queue=True)
        except (PdcdError, UnreachableError, OSError) as err:
            self.why = f"{type(err).__name__}: {err}"

    def wait(self, within_s: float) -> bool:
        """Whether it has come to an end."""
        self._thread.join(within_s)
        return not self._thread.is_alive()


class Episode:
    """Runs one daemon on a bench for so many photos, or until an attack ends it."""

    def __init__(
        self,
        bench: Bench,
        rng: Random,
        tally: Tally,
        wanted: list[CaptureRequest],
        photos: int,
        page: LivePage,
    ) -> None:
        self._bench, self._rng, self._tally, self._wanted = bench, rng, tally, wanted
        self._photos, self._page = photos, page
        self._calm = LONG_CALM if photos >= LONG else CALM
        self._attacks = [a for a in ATTACKS if self._fits(a)]

    def _fits(self, attack: Attack) -> bool:
        kinds = {"mock bench": "mocks", "camera on USB": "body", "watched folder": "card"}
        on_disk = attack.name.startswith("the disk")
        fits = not attack.on or kinds.get(self._bench.name, "windows") in attack.on
        fits = fits and not (attack.ends and self._photos >= LONG)
        return fits and (self._bench.mounted or not on_disk)

    def _drawn(self) -> Attack:
        """Most of the attacks are kills, and most of those leave the daemon alive: another one
        takes long to start."""
        kills = [
            attack
            for attack in self._attacks
            if attack.name.startswith(("kill", "SIG"))
            for _ in range(1 if attack.ends else 4)
        ]
        return self._rng.choice(kills if self._rng.random() < KILLS else self._attacks)

    def live(self, until_s: float) -> None:
        """Take photos and attack, until a monotonic time at most."""
        with Daemon(self._bench) as daemon:
            before: dict[str, int] | None = None
            first_mib: dict[int, float] = {}
            taken = 0
            while daemon.alive and time.monotonic() < until_s and taken < self._photos:
                self._round(daemon)
                taken += 1
                if taken % ROOM == 0:
                    self._folders()
                if daemon.alive and taken == WARM:
                    self._stop_picture(daemon)
                    before = processes.holdings(daemon.pid)
                if daemon.alive and taken == SETTLED:
                    self._stop_picture(daemon)
                    first_mib = processes.resident(daemon.pid)
            self._stop_picture(daemon)
            if daemon.alive:
                self._leaks(daemon, before)
                if taken >= LONG:
                    self._grown(taken - SETTLED, first_mib, processes.resident(daemon.pid))
                self._ended_politely(daemon)
            self._tally.beat_gap_s = max(self._tally.beat_gap_s, daemon.gap_s)
            self._tally.answers += daemon.kinds
            for fault in daemon.faults:
                self._promise(False, f"a hostile request was answered by {fault}")
            self._promise(daemon.gap_s <= SILENT_S, f"no heart beat for {daemon.gap_s:.1f} s")
        left = processes.gone(daemon.started, GONE_S)
        self._promise(not left, f"processes outlived their daemon: {left}")
        self._folders()

    def _round(self, daemon: Daemon) -> None:
        """One photo, and perhaps an attack on it; the live picture of the page before and after."""
        self._stop_picture(daemon)
        photo = Photographer(daemon, self._rng.choice(self._wanted))
        self._tally.captures += 1
        attack = None if self._rng.random() < self._calm else self._drawn()
        row = Row() if attack is None else self._tally.row(attack.name)
        if attack is not None:
            time.sleep(self._rng.uniform(0.0, 0.6))
            row.times += 1
            self._tally.kills += attack.do(daemon, self._rng)
        if attack is not None and attack.ends:
            self._after_the_end(daemon, attack, row)
        self._promise(photo.wait(60.0), f"{self._name(attack)}: a photo did not end within 60 s")
        state = "failed" if photo.result is None else photo.result.state
        row.ends[state] += 1
        if attack is None or not attack.spoils:
            self._promise(state == "done", f"{self._name(attack)}: a photo ended so: {_end(photo)}")
        if photo.result is not None and photo.result.error is not None:
            kind = photo.result.error["kind"]
            told = "broken as it was told to" in str(photo.result.error)
            self._promise(kind != "internal" or told, f"{self._name(attack)}: {_end(photo)}")
        if attack is not None and not attack.ends:
            attack.after(daemon)
            self._made_safe(attack, row, daemon)
        self._tally.rss_mib = max(self._tally.rss_mib, processes.rss_mib(daemon.pid))
        if daemon.alive and self._bench.live:
            live = self._page.watch_picture(self._rng.randint(1, 5))
            self._promise(live or not daemon.alive, f"no live picture: {self._page.trouble}")

    def _stop_picture(self, daemon: Daemon) -> None:
        """Have the page close its live picture: the rig is free soon after."""
        if not self._page.close_picture():
            return
        lapse = Lapse()
        with suppress(PdcdError, UnreachableError, OSError), daemon.client() as client:
            while client.status().state != "idle" and lapse.own_s < 3.0 * STOP_S:
                time.sleep(0.005)
            took_s = lapse.own_s
            self._tally.stops_s.append(took_s)
            self._promise(took_s <= STOP_S, f"a live picture held the rig for {took_s:.2f} s more")

    def _after_the_end(self, daemon: Daemon, attack: Attack, row: Row) -> None:
        self._made_safe(attack, row, daemon)
        with suppress(Exception):
            daemon.process.wait(30.0)
        self._promise(not daemon.alive, f"{attack.name}: the daemon lives on")
        if "SIGTERM" in attack.name:
            code = daemon.process.returncode
            self._promise(code == 0, f"{attack.name}: exit code {code}")

    def _made_safe(self, attack: Attack, row: Row, daemon: Daemon) -> None:
        """Panels black and shutter closed in time, seen from outside."""
        if daemon.alive and not attack.ends:
            self._idle(daemon)
        more_s = HANGS_S if "STOP" in attack.name else 0.0
        # A polite end goes through the whole of the rig's closing first.
        more_s += 5.0 if "SIGTERM" in attack.name else 0.0
        row.dark_s = max(row.dark_s, self._until(self._bench.lit, DARK_S + more_s, attack, "lit"))
        row.closed_s = max(
            row.closed_s, self._until(self._bench.is_open, CLOSED_S + more_s, attack, "open")
        )

    def _idle(self, daemon: Daemon) -> None:
        """Wait until no job of any client is left."""
        until_s = time.monotonic() + 30.0
        with suppress(PdcdError, UnreachableError, OSError), daemon.client() as client:
            while client.status().state != "idle" and time.monotonic() < until_s:
                time.sleep(0.02)
            self._promise(time.monotonic() < until_s, "the rig is not free 30 s after a photo")

    def _until(
        self, still: Callable[[], bool] | None, limit_s: float, attack: Attack, what: str
    ) -> float:
        """Seconds until a look from outside finds the bench safe."""
        if still is None:
            return 0.0
        lapse = Lapse()
        with suppress(OSError, ConnectionError):  # the X server itself was killed
            while still() and lapse.own_s < 3.0 * limit_s:
                time.sleep(0.005)
        took_s = lapse.own_s
        self._promise(took_s <= limit_s, f"{attack.name}: {what} for {took_s:.2f} s")
        return took_s

    def _leaks(self, daemon: Daemon, before: dict[str, int] | None) -> None:
        """What the daemon holds now against what it held after its first photos."""
        if before is None:
            return
        self._idle(daemon)
        time.sleep(0.5)  # connections that were left are being taken down
        now = processes.holdings(daemon.pid)
        for name, count in now.items():
            kept = count <= before[name] + SPARE[name]
            self._promise(kept, f"{name} grew from {before[name]} to {count}")

    def _grown(self, photos: int, first: dict[int, float], now: dict[int, float]) -> None:
        """No growth to speak of, of those processes that lived through all these photos."""
        mib = sum(now[pid] - first[pid] for pid in first.keys() & now.keys())
        self._tally.growth.append((photos, mib))
        self._promise(mib <= GROWN_MIB, f"it grew by {mib:.1f} MiB in {photos} photos")

    def _ended_politely(self, daemon: Daemon) -> None:
        daemon.look()
        daemon.process.terminate()
        with suppress(Exception):
            daemon.process.wait(30.0)
        code = daemon.process.returncode
        self._promise(code == 0, f"SIGTERM to an idle daemon: exit code {code}")
        self._promise(not daemon.socket.exists(), "the socket's file was left behind")

    def _folders(self) -> None:
        """Every folder that looks finished is; then all of them are removed, to have room."""
        captures = self._bench.state / "captures"
        for folder in captures.iterdir() if captures.is_dir() else ():
            if (folder / "capture.json").exists() and folder.suffix != ".partial":
                self._tally.folders += 1
                try:
                    found = verify_run(folder)
                    self._promise(found.whole, f"{folder.name} is not whole: {found}")
                except PdcdError as err:
                    self._promise(False, f"{folder.name} is not sound: {err}")
            shutil.rmtree(folder, ignore_errors=True)

    def _promise(self, kept: bool, what: str) -> None:
        self._tally.promise(kept, f"{self._bench.name}: {what}")

    @staticmethod
    def _name(attack: Attack | None) -> str:
        return "in peace" if attack is None else attack.name


def _end(photo: Photographer) -> str:
    if photo.result is None:
        return photo.why
    return f"{photo.result.state}, {photo.result.error}"
