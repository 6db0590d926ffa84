"""A process that another one attends to: it pauses when told to, and ends when nobody is there any more."""

from __future__ import annotations

import _thread
import signal
import threading
from typing import TextIO

PAUSE, GO_ON = "pause", "go on"
"""The words that the attending process writes, one a line."""


class Attendance:
    """Whoever started this process, at the other end of its standard input.

    A window that crashes takes nothing down by itself; the pipe that it held closes, and this process is interrupted
    as by Ctrl-C.

    Made in the main thread.

    Args:
        stream: The reading end.
    """

    def __init__(self, stream: TextIO):
        # What a shell starts in its background ignores Ctrl-C, and its children after it.
        if signal.getsignal(signal.SIGINT) in (signal.SIG_IGN, signal.SIG_DFL):
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self._may_go_on = threading.Event()
        self._may_go_on.set()
        threading.Thread(target=self._listen, args=(stream,), daemon=True).start()

    def wait(self) -> None:
        """Come back at once, or, while paused, when told to go on."""
        self._may_go_on.wait()

    def _listen(self, stream: TextIO) -> None:
        for line in stream:
            if line.strip() == PAUSE:
                self._may_go_on.clear()
            elif line.strip() == GO_ON:
                self._may_go_on.set()
        _thread.interrupt_main()
        self._may_go_on.set()
