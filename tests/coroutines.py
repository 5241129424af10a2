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


def entered(**makes: Callable[..., AbstractAsyncContextManager[Any]]) -> Callable[[Scene], Scene]:
    """Decorate a coroutine test: these parameters are context managers, entered in its loop.

    What makes one may itself have fixtures as its parameters.
    """
    needs = {name: inspect.signature(make).parameters for name, make in makes.items()}

    def decorate(body: Scene) -> Scene:
        wanted = inspect.signature(body).parameters
        own = {name: one for name, one in wanted.items() if name not in makes}
        extra = {n: one for need in needs.values() for n, one in need.items() if n not in own}

        @functools.wraps(body)
        async def test(**fixtures: Any) -> None:
            async with AsyncExitStack() as stack:
                made = {}
                for name, make in makes.items():
                    given = {n: fixtures[n] for n in needs[name]}
                    made[name] = await stack.enter_async_context(make(**given))
                await body(**made, **{name: fixtures[name] for name in own})

        sign_test(test, [*own.values(), *extra.values()])
        return test

    return decorate


def sign_test(test: Callable[..., Any], parameters: list[inspect.Parameter]) -> None:
    """Have pytest see these parameters of a test that wraps another function."""
    del test.__wrapped__  # type: ignore[attr-defined]
    test.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
