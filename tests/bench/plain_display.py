"""What a script would do: one window for each output, each pattern uploaded when it is due.

Run as a process of its own: ``python -m tests.bench.plain_display FRAMES HZ SIZES``, 0 Hz for as
fast as it goes; prints one JSON object. No real-time priority, no log, sleeps until the next frame.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import glfw
import moderngl
import numpy as np

VERTEX = """#version 330
void main() { gl_Position = vec4(4 * (gl_VertexID & 1) - 1, 2 * (gl_VertexID & 2) - 1, 0, 1); }"""
FRAGMENT = """#version 330
uniform sampler2D cells; uniform vec2 size; out vec3 colour;
void main() { colour = texture(cells, gl_FragCoord.xy / size).rrr; }"""


def main(frames: int, hz: float, sizes: list[int]) -> None:
    """Show random 64 x 48 patterns; print how that went."""
    glfw.init()
    rng = np.random.default_rng(0)
    codes = (rng.random((64, 48, 64)) < 0.5).astype(np.uint8) * 255
    windows: list[Any] = []
    for x, width, height in ((0, *sizes[:2]), (sizes[0], *sizes[2:])):
        glfw.window_hint(glfw.DECORATED, False)
        glfw.window_hint(glfw.POSITION_X, x)
        glfw.window_hint(glfw.POSITION_Y, 0)
        window = glfw.create_window(width, height, "plain", None, None)
        glfw.make_context_current(window)
        glfw.swap_interval(1 if not windows else 0)
        context = moderngl.create_context()
        program = context.program(VERTEX, FRAGMENT)
        program["size"] = (width, height)
        texture = context.texture((64, 48), 1)
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        windows.append((window, context, texture, context.vertex_array(program, [])))
    stamps, late, cpu = [], [], []
    due, spent = time.perf_counter(), time.thread_time()
    for number in range(frames):
        if hz:
            due += 1.0 / hz
            time.sleep(max(0.0, due - time.perf_counter()))
            late.append(time.perf_counter() - due)
        for side, (window, context, texture, quad) in enumerate(windows):
            glfw.make_context_current(window)
            texture.write(codes[(number + side) % 64].tobytes())
            texture.use()
            quad.render(vertices=3)
            context.finish()
        for window, *_ in windows:
            glfw.swap_buffers(window)
        glfw.poll_events()
        spent, before = time.thread_time(), spent
        cpu.append(spent - before)
        stamps.append(time.perf_counter())
    sys.stdout.write(json.dumps({"stamps_s": stamps, "late_s": late, "cpu_s": cpu}) + "\n")
    glfw.terminate()


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]), [int(word) for word in sys.argv[3:]])
