"""Jobs run in threads, and what they come to brought into the calling one, whole where it is interrupted."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from typing import Generic, TypeVar

from ..interrupts import second_ends

J = TypeVar("J")
T = TypeVar("T")


Look = Callable[[int, int], None]
"""What a run calls now and then; it raises KeyboardInterrupt where all is to end."""


def execute(
    jobs: Iterator[J],
    made: Callable[[], Callable[[J, Look], T]],
    workers: int | None,
    ended: Callable[[J, T], None],
) -> None:
    """Run jobs in `workers` threads (None: one per core), and call `ended(job, value)` in this one.

    Each thread runs its jobs with what it has `made`, and closes that in the end where it can be closed. Raises what a run
    raises, after the threads have ended and `ended` has been called for all that is finished.
    """
    pool = _Pool(jobs, made)
    with second_ends():
        try:
            pool.start(workers or os.cpu_count() or 1)
            while pool.running:
                pool.receive(ended)
        except BaseException:
            pool.stop.set()
            while pool.running:
                pool.receive(ended)
            raise
        finally:
            pool.join()
    pool.raise_error()


class _Pool(Generic[J, T]):
    """Threads that take jobs in turns."""

    def __init__(self, jobs: Iterator[J], made: Callable[[], Callable[[J, Look], T]]) -> None:
        self.jobs, self.made = jobs, made
        self.stop, self._lock = threading.Event(), threading.Lock()
        self._finished: SimpleQueue[tuple[J, T] | BaseException | None] = SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._errors: list[BaseException] = []
        self.running = 0

    def start(self, count: int) -> None:
        for k in range(count):
            thread = threading.Thread(target=self._work, name=f"runs {k}")
            thread.start()
            self._threads.append(thread)
            self.running += 1

    def receive(self, ended: Callable[[J, T], None]) -> None:
        """Wait for a job that has ended, or a thread."""
        item = self._finished.get()
        if isinstance(item, tuple):
            ended(*item)
            return
        self.running -= 1
        if item is not None:
            self._errors.append(item)

    def join(self) -> None:
        self.stop.set()
        for thread in self._threads:
            thread.join()

    def raise_error(self) -> None:
        """Raise the first error of a run, not that by which the others were stopped."""
        for error in sorted(self._errors, key=lambda e: isinstance(e, KeyboardInterrupt)):
            raise error

    def _look(self, _done: int, _total: int) -> None:
        if self.stop.is_set():
            raise KeyboardInterrupt

    def _work(self) -> None:
        try:
            run = self.made()
            try:
                while (job := self._next()) is not None:
                    self._finished.put((job, run(job, self._look)))
            finally:
                getattr(run, "close", lambda: None)()
        except BaseException as error:
            self.stop.set()
            self._finished.put(error)
        else:
            self._finished.put(None)

    def _next(self) -> J | None:
        with self._lock:
            return None if self.stop.is_set() else next(self.jobs, None)
