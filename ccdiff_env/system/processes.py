"""Processes that work for another one."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import active_children, get_context, parent_process
from threading import Thread
from typing import TypeVar

from ccdiff_env.system.files import writing

_Work = TypeVar("_Work")
_Result = TypeVar("_Result")


def results_of_processes(
    do: Callable[[_Work], _Result], works: Iterable[_Work], workers: int
) -> Iterator[_Result]:
    """Yield what a function returns for each work, as it is done, by several processes.

    Its first error is raised here, and ends the processes at once, as Ctrl-C does: what they were
    about is lost, and what waits is not begun. They end with this process as well.
    """
    # forked children may not enter worlds that hold threads
    context, others = get_context("spawn"), set(active_children())
    with writing("/dev/shm"):
        made = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin)
    with made as pool:
        try:
            for future in as_completed([pool.submit(do, work) for work in works]):
                yield future.result()
        except BaseException:
            for worker in set(active_children()) - others:
                worker.terminate()
            raise


def _begin() -> None:
    """Let this worker end when the process that began it does, and by it alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=watch, daemon=True).start()
