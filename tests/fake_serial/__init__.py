"""Serial ports for tests, reached through pyserial's own `serial_for_url`.

`fake_line` makes a ``line://NAME`` port that writes down every edge of RTS and DTR with its time;
`modem_lines` lets a pseudo-terminal take the requests for modem lines that its driver refuses.
"""

from tests.fake_serial.lines import Edge, FakeLine, fake_line
from tests.fake_serial.shim import ModemLines, modem_lines

__all__ = ["Edge", "FakeLine", "ModemLines", "fake_line", "modem_lines"]
