import sys

import pytest

from twin.devices.lumio.config import TRANSPORTS, ScreenError


@pytest.mark.parametrize("kind", sorted(TRANSPORTS))
def test_a_port_that_cannot_be_opened_without_posix_is_said_in_one_line(kind, monkeypatch):
    for name in ("fcntl", "termios"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ScreenError, match=r"^touch screen /dev/x: needs Linux or macOS, \w+ is"):
        TRANSPORTS[kind]("/dev/x", 9600).open()
