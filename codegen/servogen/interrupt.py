"""Ctrl-C as a flag: work that must not stop half-way looks at it where stopping is safe."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, current_thread, main_thread


@contextmanager
def interrupt_kept() -> Iterator[Event]:
    """Ctrl-C sets the event instead of raising KeyboardInterrupt wherever the code happens to be."""
    interrupted = Event()
    if current_thread() is not main_thread():  # only there do signals arrive
        yield interrupted
        return
    before = signal.signal(signal.SIGINT, lambda number, frame: interrupted.set())
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, before)
