"""Tests that are coroutines: each runs in an event loop of its own. Imported by rooms' conftest."""

from __future__ import annotations

import asyncio
import functools
import inspect
from collections.abc import Callable, Coroutine
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from typing import Any

import pytest

Scene = Callable[..., Coroutine[Any, Any, None]]


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run the test if it is a coroutine, with its fixtures; leave others to pytest."""
    body = pyfuncitem.obj
    if not inspect.iscoroutinefunction(body):
        return None
    names = inspect.signature(body).parameters
    asyncio.run(body(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


def entered(**makes: Callable[[], AbstractAsyncContextManager[Any]]) -> Callable[[Scene], Scene]:
    """Decorate a coroutine test: these parameters are context managers, entered in its loop."""

    def decorate(body: Scene) -> Scene:
        @functools.wraps(body)
        async def test(**fixtures: Any) -> None:
            async with AsyncExitStack() as stack:
                own = {n: await stack.enter_async_context(make()) for n, make in makes.items()}
                await body(**own, **fixtures)

        sign_test(test, [one for name, one in _parameters(body).items() if name not in makes])
        return test

    return decorate


def sign_test(test: Callable[..., Any], parameters: list[inspect.Parameter]) -> None:
    """Have pytest see these parameters of a test that wraps another function."""
    del test.__wrapped__  # type: ignore[attr-defined]
    test.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]


def _parameters(body: Scene) -> dict[str, inspect.Parameter]:
    return dict(inspect.signature(body).parameters)
