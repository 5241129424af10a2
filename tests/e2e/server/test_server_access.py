"""Who may connect, and who may do what: by user and group, in one place, for every method."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from pdcd.bench.tables import RoleConfig, ServerConfig
from pdcd.protocol.messages import METHODS
from pdcd.protocol.views import ClientRole
from pdcd.server import access
from pdcd.server.access import Access, Peer, peer_of
from tests.e2e.server._server_harness import Daemon, Wire, daemon, served
from tests.e2e.server._users import ANNA, BERT, CARL, Users

ROLES = ServerConfig(
    look=RoleConfig(uids=(ANNA,), groups=(5001,)),
    shoot=RoleConfig(uids=(BERT,)),
    administer=RoleConfig(uids=(CARL,)),
)


# --- who is it ----------------------------------------------------------------------------------


def test_the_kernel_tells_who_connected() -> None:
    left, right = socket.socketpair()
    with left, right:
        peer = peer_of(left)
    assert (peer.pid, peer.uid, peer.gid) == (os.getpid(), os.getuid(), os.getgid())
    assert peer.groups == set(os.getgroups())


@pytest.mark.skipif(os.getuid() != 0, reason="only root can take on other groups")
def test_the_kernel_tells_the_groups_of_who_connected(tmp_path: Path) -> None:
    path = tmp_path / "s"
    script = f"import socket; s = socket.socket(1); s.connect({str(path)!r}); s.recv(1)"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        child = subprocess.Popen([sys.executable, "-c", script], extra_groups=[4242, 4243])
        with child, listener.accept()[0] as sock:
            assert peer_of(sock).groups == {4242, 4243}
            sock.sendall(b"x")


def test_no_user_database_is_asked_about_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(*_: Any) -> Any:
        raise AssertionError("this may hang")

    for module, name in (("os", "getgrouplist"), ("pwd", "getpwuid"), ("grp", "getgrall")):
        monkeypatch.setattr(f"{module}.{name}", hang)
    left, right = socket.socketpair()
    with left, right:
        assert Access({os.getuid(): ClientRole.SHOOT}, {}).role(peer_of(left)) is ClientRole.SHOOT


async def test_a_lookup_that_hangs_holds_up_nobody_else(
    tmp_path: Path, users: Users, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = threading.Event()

    def look_up(uid: int) -> str:
        if uid == BERT:
            gate.wait(20.0)
        return f"user {uid}"

    monkeypatch.setattr(access, "_user_name", look_up)
    monkeypatch.setattr(access, "LOOKUP_S", 0.2)
    async with daemon(tmp_path, server=ROLES) as running, running.wire() as honest:
        users.become(BERT)
        reader, writer = await asyncio.open_unix_connection(str(running.path))
        hung = Wire(reader, writer)
        served = 0
        while not reader._buffer:  # type: ignore[attr-defined]
            await honest.result("ping")
            served += 1
        assert served > 5
        # Served all the same, by number; and the second time without a wait.
        assert (await hung.receive())["method"] == "hello"
        assert (await job_of(hung))["user"] == str(BERT)
        monkeypatch.setattr(access, "LOOKUP_S", 600.0)
        async with running.wire():
            pass
        gate.set()
        while (await job_of(hung))["user"] != f"user {BERT}":
            await asyncio.sleep(0.01)
            await hung.close()
            reader, writer = await asyncio.open_unix_connection(str(running.path))
            hung = Wire(reader, writer)
            await hung.receive()
        await hung.close()


async def job_of(wire: Wire) -> dict[str, Any]:
    """The owner of a new job of this client."""
    job = (await wire.result("capture.start", goal="white"))["job"]
    await wire.result("capture.wait", job=job)
    views = {view["job"]: view for view in (await wire.result("capture.list"))["jobs"]}
    owner: dict[str, Any] = views[job]["owner"]
    return owner


# --- which role ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("peer", "role"),
    [
        (Peer(1, 1000, 1000, "own"), ClientRole.ADMINISTER),
        (Peer(1, 1001, 1001, "listed"), ClientRole.SHOOT),
        (Peer(1, 1002, 4242, "of the group"), ClientRole.SHOOT),
        (Peer(1, 1002, 1, "of the group, too", frozenset({7, 4242})), ClientRole.SHOOT),
        (Peer(1, 1003, 1003, "looks"), ClientRole.LOOK),
        (Peer(1, 1003, 1003, "looks, but of the group", frozenset({4242})), ClientRole.SHOOT),
        (Peer(1, 1002, 1002, "stranger", frozenset({1, 2, 3})), None),
        (Peer(1, 4242, 1002, "stranger with the number of a group"), None),
        (Peer(1, 1002, 1000, "stranger in a group with the number of a user"), None),
    ],
)
def test_the_highest_role_that_user_or_group_gives(peer: Peer, role: ClientRole | None) -> None:
    rule = Access(
        {1000: ClientRole.ADMINISTER, 1001: ClientRole.SHOOT, 1003: ClientRole.LOOK},
        {4242: ClientRole.SHOOT},
    )
    assert rule.role(peer) is role


@pytest.mark.parametrize(
    ("mode", "open_to_group"), [(0o600, False), (0o660, True), (0o666, True), (0o640, False)]
)
def test_the_socket_and_the_configuration_give_roles(
    tmp_path: Path, mode: int, open_to_group: bool
) -> None:
    path = tmp_path / "s"
    tables = ServerConfig(
        allow_uids=(77,),
        look=RoleConfig(uids=(77, 78), groups=(5001,)),
        administer=RoleConfig(uids=(79,), groups=("root", 5001)),
    )
    with socket.socket(socket.AF_UNIX) as sock:
        sock.bind(str(path))
        path.chmod(mode)
        rule = Access.to(sock, tables)
    own = dict.fromkeys({0, os.geteuid()}, ClientRole.ADMINISTER)
    assert rule.uids == {77: ClientRole.SHOOT, 78: ClientRole.LOOK, 79: ClientRole.ADMINISTER} | own
    assert rule.own == set(own)
    group = {path.stat().st_gid: ClientRole.SHOOT} if open_to_group else {}
    assert rule.gids == group | {0: ClientRole.ADMINISTER, 5001: ClientRole.ADMINISTER}


def test_an_abstract_socket_has_no_group() -> None:
    with socket.socket(socket.AF_UNIX) as sock:
        sock.bind(f"\0pdcd-test-{os.getpid()}")
        assert Access.to(sock, ServerConfig()).gids == {}


# --- what each may do ---------------------------------------------------------------------------

LOOK = {"hello", "ping", "rig.status", "rig.describe", "capture.wait", "capture.list"}
LOOK |= {"events.subscribe", "events.unsubscribe"}
SHOOT = {"config.get", "capture.plan", "capture.start", "capture.cancel", "display.show"}
SHOOT |= {"preview.grab", "preview.live", "preview.frame", "calibrate.start", "calibrate.proceed"}
SHOOT |= {"stream.start", "stream.frame", "stream.record"}

SOUND: dict[str, dict[str, Any]] = {
    "hello": {"protocol": [1, 0]},
    "capture.plan": {"goal": "white"},
    "capture.start": {"goal": "white"},
    "display.show": {"pattern": "black"},
    "stream.start": {"goal": "white"},
}


async def kinds(wire: Wire, job: str) -> dict[str, str]:
    """How each method ends for this client: "" where it is done, else the kind of its error."""
    found, live = {}, ""
    for method in METHODS:
        params = {"job": job} if method.endswith((".wait", ".cancel", ".proceed")) else {}
        if method in ("preview.frame", "stream.frame", "stream.record"):
            params = {"job": live or job}
        answer = await wire.ask(method, **SOUND.get(method, params))
        found[method] = answer["error"]["data"]["kind"] if "error" in answer else ""
        if method in ("preview.live", "stream.start") and "result" in answer:
            live = answer["result"]["job"]
        elif method in ("preview.frame", "stream.record") and live:
            await wire.result("capture.cancel", job=live)
            live = ""
        elif method.endswith(".start") and "result" in answer:
            await wire.result("capture.wait", job=answer["result"]["job"])
    return found


@served(server=ROLES)
async def test_every_method_is_refused_below_its_role(
    running: Daemon, root: Wire, users: Users
) -> None:
    job = (await root.result("capture.start", goal="white"))["job"]
    await root.result("capture.wait", job=job)
    users.become(ANNA)
    before = list(running.engine.calls)
    async with running.wire() as wire:
        found = await kinds(wire, job)
    assert {method for method, kind in found.items() if not kind} == LOOK
    assert {found[method] for method in SHOOT} == {"denied"}
    assert running.engine.calls == [*before, "describe"]
    users.become(CARL, 5001)
    async with running.wire() as wire:
        assert set((await kinds(wire, job)).values()) == {""}
    users.become(BERT, 5001)
    async with running.wire() as wire:
        found = await kinds(wire, job)
        assert (await wire.error("preview.frame", job=job))["data"]["kind"] == "denied"
    for method in ("capture.cancel", "calibrate.proceed"):
        assert found.pop(method) == "denied"  # root's job
    assert set(found.values()) == {""}
    assert set(METHODS) == LOOK | SHOOT


async def test_only_its_owner_or_an_administrator_cancels_a_job(
    tmp_path: Path, users: Users
) -> None:
    tables = ServerConfig(shoot=RoleConfig(uids=(ANNA, BERT)), administer=RoleConfig(uids=(CARL,)))

    async with daemon(tmp_path, server=tables) as running:
        users.become(ANNA)
        async with running.wire() as wire:
            running_job = await start(wire, detach=True)
            waiting = await start(wire, detach=True)
            last = await start(wire, detach=True)
            users.become(BERT)
            async with running.wire() as other:
                await refused(other, running_job, waiting, last)
                await other.result("rig.status")
        # Anna has gone: neither the next connection nor the one of her number is hers.
        async with running.wire() as other:
            await refused(other, running_job, waiting)
            assert (await other.result("rig.status"))["running"]["job"] == running_job
        users.become(ANNA)
        async with running.wire() as again:
            assert (await again.result("capture.cancel", job=waiting))["state"] == "cancelled"
        users.become(CARL)
        async with running.wire() as boss:
            for job in (last, running_job):
                ended = await boss.result("capture.cancel", job=job)
                assert ended["state"] == "cancelled"
        users.become(BERT)
        async with running.wire() as other:
            await refused(other, running_job)  # also when nothing is left to cancel
            assert (await other.result("capture.wait", job=last))["state"] == "cancelled"


async def start(wire: Wire, **params: Any) -> str:
    job: str = (
        await wire.result("capture.start", goal="white", note="slow", queue=True, **params)
    )["job"]
    return job


async def refused(wire: Wire, *jobs: str) -> None:
    for job in jobs:
        error = await wire.error("capture.cancel", job=job)
        assert error["data"]["kind"] == "denied" and error["code"] == -32010
        assert f"uid {ANNA}" in error["message"] and "administer" in error["data"]["hint"]
        # As a notification, which gets no answer, it does no more.
        await wire.send(
            b'{"jsonrpc":"2.0","method":"capture.cancel","params":{"job":"%b"}}' % job.encode()
        )


@served(server=ROLES)
async def test_a_user_who_is_not_permitted_is_told_so_and_gets_no_hello(
    running: Daemon, users: Users
) -> None:
    users.become(ANNA + 10)
    async with running.wire() as wire:
        error = wire.hello["error"]
        assert error["data"]["kind"] == "denied"
        assert f"uid {ANNA + 10}" in error["message"]
        assert "allow_uids" in error["data"]["hint"]
        assert await wire.ended()
