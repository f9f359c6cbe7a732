"""Work as tasks of a Ray cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from ccdiff_env.errors import MissingFeatureError

_Work = TypeVar("_Work")
_Result = TypeVar("_Result")
RETRIES = 5  #: Times that the work of a lost worker is tried again.


def results_of_tasks(do: Callable[[_Work], _Result], works: Sequence[_Work]) -> Iterator[_Result]:
    """Yield what a function returns for each work, as it is done.

    The cluster is that which this process belongs to (``ray.init`` decides which). Errors of the
    function are raised here.
    """
    try:
        import ray
    except ImportError as error:
        raise MissingFeatureError("--backend ray needs Ray: pip install 'ray>=2.30'") from error

    if not ray.is_initialized():
        ray.init(log_to_driver=False)
    task = ray.remote(max_retries=RETRIES, retry_exceptions=False)(do)
    waiting = [task.remote(work) for work in works]
    while waiting:
        ready, waiting = ray.wait(waiting, num_returns=1)
        yield from ray.get(ready)
