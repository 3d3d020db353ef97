"""Tasks on the workers of a Dask scheduler."""

import logging
import sys
from collections.abc import Sequence
from typing import Any

from tqdm import tqdm

from torchbrdf.sweep.tasks import Call, Finished, Task

_CONNECT_SECONDS = 10


def on_cluster(call: Call, tasks: Sequence[Task], address: str) -> Finished:
    """Results of a function as they are finished; ConnectionError or ChildProcessError where the cluster fails."""
    try:
        import distributed
    except ImportError:
        raise ValueError("a scheduler needs dask.distributed: pip install 'torchbrdf[cluster]'") from None
    try:
        client = distributed.Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ConnectionError(
            f"no Dask scheduler answers at {address} ({type(error).__name__}); start one with `dask scheduler`, "
            "workers with `dask worker ADDRESS --nthreads 1`, and give its address"
        ) from None
    log = logging.getLogger("distributed.client")  # says at length what one line below says
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with client:
            yield from _computed(client, call, tasks)
    except distributed.KilledWorker:
        raise ChildProcessError(
            f"{address}: workers were killed again and again in the same task, perhaps for want of memory; the same "
            "command goes on"
        ) from None
    except distributed.CancelledError:
        raise ConnectionError(f"{address}: the Dask scheduler is gone; the same command goes on") from None
    finally:
        log.setLevel(level)


def _computed(client: Any, call: Call, tasks: Sequence[Task]) -> Finished:
    from distributed import as_completed

    if not client.scheduler_info()["workers"]:
        tqdm.write("the Dask scheduler has no workers yet; waiting for one", file=sys.stderr)
    futures = {client.submit(call, task, pure=False): task for task in tasks}
    try:
        for future in as_completed(list(futures), loop=client.loop):
            result = future.result()
            yield futures.pop(future), result
            future.release()  # else it would be computed again for nobody where its worker dies
    finally:
        client.cancel(list(futures), force=True)
