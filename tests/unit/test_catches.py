"""Who may catch every exception: few, and each for a reason.

Whoever catches more than it knows how to mend hides faults of the program, and goes on with a
shutter or a panel in a state that nobody knows. So all others name what they catch. To close what
was opened and raise the same again is always right.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from tests.places import ROOT

ALL = {"Exception", "BaseException"}
ALLOWED = {
    "drivers/virtual_camera/shutter.py::CameraShutter._collect": "a thread: the camera says so",
    "drivers/virtual_genicam/camera.py::VirtualGenicamCamera._end": "a thread: no frame comes",
    "pdcd/api/stream.py::_Shared.run": "a thread hands it to whoever waits",
    "pdcd/api/task.py::take_capture": "a capture of a sweep: the others go on",
    "pdcd/bench/registry.py::_import": "a stranger's module, raised as a driver that is none",
    "pdcd/bench/registry.py::name_driver_errors": "a stranger's driver, raised as its device",
    "pdcd/child.py::MessageLine._decoded": "what a child says may be anything: the talk ends",
    "pdcd/capture/check.py::_Check._try": "a stranger's driver: the check tells what it found",
    "pdcd/capture/engine.py::Engine.capture": "a job ends, the daemon stays",
    "pdcd/capture/engine.py::Engine.calibrate": "a job ends, the daemon stays",
    "pdcd/capture/safety.py::release_device": "one device must not keep the others held",
    "pdcd/capture/safety.py::_insist": "one device must not keep the others from being safe",
    "pdcd/capture/rig.py::Rig.refusal": "a stranger's display that knows no pixels: it is told",
    "pdcd/capture/live.py::run_live_view": "a job ends, and its result says by what",
    "pdcd/capture/live.py::_make_dark": "panels that do not go black are asked again",
    "pdcd/capture/live.py::FinderThread._run": "a thread hands it to whoever waits",
    "pdcd/capture/stream.py::PictureMaker._run": "a thread hands it to whoever waits",
    "pdcd/capture/streaming.py::run_stream": "a job ends, the daemon stays",
    "pdcd/capture/streaming.py::_record": "a run was not made: the stream goes on",
    "pdcd/capture/run.py::CaptureRun._report": "the run is there; its report can be made again",
    "pdcd/capture/worker/process.py::_answer": "the work process's answer, raised in the daemon",
    "pdcd/pictures/decode.py::convert_record_errors": "a record that fits no files, raised as that",
    "pdcd/presenter/process.py::run_display_process": "it ends: black, then it is told",
    "pdcd/testing/promises.py::Promise.keep": "a stranger's driver: raised as a promise it broke",
    "pdcd/testing/promises.py::Promise.require_error": "the same",
    "pdcd/server/aside.py::Outcome.of": "a thread hands it to whoever waits",
    "pdcd/errors.py::_said_by": "somebody else's error, which cannot even be told",
    "pdcd/server/reading.py::answer_request": "a request gets an answer, whatever happens",
    "pdcd/server/runner.py::Runner._use_rig": "a job ends, the daemon stays",
    "pdcd/server/runner.py::Runner._go_black": "a job ends, the daemon stays",
    "pdcd/server/runner.py::Runner._tell": "a job ends, whoever could not be told",
    "pdcd/web/serve.py::_accept": "one connection fails, others come",
    "pdcd/api/sweep.py::_all_on": "a capture that a cluster loses is a row",
    "pdcd/web/app.py::Site._keep": "a request gets an answer, whatever happens",
}
"""Functions and why they may."""


def names(node: ast.AST | None) -> set[str]:
    """What a handler catches; `except:` is everything."""
    if node is None:
        return {"BaseException"}
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def raises_again(handler: ast.ExceptHandler) -> bool:
    last = handler.body[-1]
    return isinstance(last, ast.Raise) and last.exc is None


def catching(path: str, source: str) -> Iterator[str]:
    """Functions of a file that catch everything and keep it."""

    def walk(node: ast.AST, function: str) -> Iterator[str]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            function = f"{function}.{node.name}".lstrip(".")
        if (
            isinstance(node, ast.ExceptHandler)
            and names(node.type) & ALL
            and not raises_again(node)
        ):
            yield f"{path}::{function}"
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress"):
            if any(names(arg) & ALL for arg in node.args):
                yield f"{path}::{function}"
        for child in ast.iter_child_nodes(node):
            yield from walk(child, function)

    return walk(ast.parse(source), "")


def test_only_these_catch_everything_and_keep_it() -> None:
    found = {
        place
        for folder in ("pdcd", "drivers")
        for file in sorted((ROOT / folder).rglob("*.py"))
        for place in catching(file.relative_to(ROOT).as_posix(), file.read_text(encoding="utf-8"))
    }
    assert found == set(ALLOWED)


@pytest.mark.parametrize(
    ("handler", "caught"),
    [
        ("except Exception:\n        pass", True),
        ("except (OSError, Exception) as err:\n        print(err)", True),
        ("except:\n        pass", True),
        ("except BaseException:\n        close()\n        raise", False),
        ("except Exception as err:\n        raise Other() from err", True),
        ("except OSError:\n        pass", False),
    ],
)
def test_what_counts_as_that(handler: str, caught: bool) -> None:
    source = f"def f():\n    try:\n        g()\n    {handler}\n"
    assert list(catching("a.py", source)) == (["a.py::f"] if caught else [])
    quiet = "with contextlib.suppress(Exception):\n    f()\n"
    assert list(catching("a.py", quiet)) == ["a.py::"]
