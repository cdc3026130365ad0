"""Work spread over the workers of a Dask cluster, of which any may die.

Dask gives the items of a worker that died to others, and makes results again that died with it.
Workers need geograph in the same version; ``pip install 'geograph[dask]'`` brings Dask.
"""

from __future__ import annotations

import logging
import threading
import warnings
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TypeVar

from geograph.errors import InputError
from geograph.workers import Lost, attempt, run_isolated

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence

Item = TypeVar("Item")
Result = TypeVar("Result")

CONNECT_S, WORKERS_S = 5.0, 10.0
"""How long a scheduler may take to answer, and its first worker to appear, seconds."""

ATTEMPTS = 4
"""How often an item is begun whose process died, which is Dask's own habit."""

# Items handed to the scheduler beforehand, for each thread and besides: memory stays flat.
_AHEAD, _AHEAD_AT_LEAST = 4, 64

# GTSAM holds Python's global lock, and BLAS threads are a property of the process: a worker with
# several threads gains nothing and does one item at a time.
_ONE_AT_A_TIME = threading.Lock()


def spread(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    workers: int,
    scheduler: str | None = None,
) -> Generator[tuple[int, Result | Lost], None, None]:
    """Yield index and result of each item as they are done: here, in processes or on a cluster.

    An item whose process or worker died is begun again.

    Parameters
    ----------
    function
        Importable from a module.
    items
        Its arguments, picklable.
    workers
        Processes on this machine; 1: this one.
    scheduler
        Address of a Dask scheduler, which is used instead.

    Raises
    ------
    InputError
        If no scheduler answers there, or its workers are not there or not of use.
    """
    if scheduler is not None:
        yield from run_on_cluster(function, items, scheduler=scheduler)
    elif workers == 1 or len(items) == 1:
        for index, item in enumerate(items):
            yield index, attempt(function, item)
    else:
        yield from run_isolated(function, items, workers=workers, attempts=ATTEMPTS)


def run_on_cluster(
    function: Callable[[Item], Result], items: Sequence[Item], *, scheduler: str
) -> Generator[tuple[int, Result | Lost], None, None]:
    """Yield index and result of each item as the workers of a Dask cluster give them.

    Parameters
    ----------
    function, items
        As in :func:`spread`.
    scheduler
        Its address, ``tcp://host:port``.

    Raises
    ------
    InputError
        As in :func:`spread`.
    ConnectionError
        If the scheduler goes away.
    """
    with connected(scheduler) as client:
        from distributed import as_completed

        ahead = _AHEAD_AT_LEAST + _AHEAD * sum(client.nthreads().values())
        waiting = iter(enumerate(items))
        index_of: dict[str, int] = {}
        done = as_completed(loop=client.loop, raise_errors=False)

        def submit() -> None:
            for index, item in waiting:
                future = client.submit(_one, function, item, pure=False)
                index_of[future.key] = index
                done.add(future)
                return

        for _ in range(min(ahead, len(items))):
            submit()
        for future in done:
            result = _result(future, scheduler)
            index = index_of.pop(future.key)
            future.release()
            submit()
            yield index, result


@contextmanager
def connected(scheduler: str) -> Iterator[Any]:
    """Give a client of a Dask scheduler that has workers with this version of geograph.

    Parameters
    ----------
    scheduler
        Its address.

    Raises
    ------
    InputError
        If Dask is not installed here, no scheduler answers there, or its workers are not there or
        have another version.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--scheduler needs Dask; install it with pip install 'geograph[dask]'"
        ) from None
    # What it says while a connection ends is said again by the errors that follow; what a dead
    # worker had is done again.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--scheduler {scheduler}: no Dask scheduler answers there "
                f"({type(error).__name__}); expected the address that dask scheduler prints, such "
                "as tcp://127.0.0.1:8786"
            ) from None
    try:
        _check_workers(client, scheduler)
        yield client
    finally:
        with suppress(Exception):
            client.close(timeout=CONNECT_S)


def _check_workers(client: Any, scheduler: str) -> None:
    from geograph import __version__

    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError:
        raise InputError(
            f"--scheduler {scheduler}: has no workers; start some with: dask worker {scheduler}"
        ) from None
    try:
        found = client.run(_version)
    except Exception as error:
        raise InputError(
            f"--scheduler {scheduler}: a worker cannot use geograph ({type(error).__name__}: "
            f"{error}); install geograph {__version__} there"
        ) from None
    others = sorted({version for version in found.values() if version != __version__})
    if others:
        raise InputError(
            f"--scheduler {scheduler}: workers have geograph {', '.join(others)}; expected "
            f"{__version__} as here"
        )


def _version() -> str:
    from geograph import __version__

    return __version__


def _one(function: Callable[[Item], Result], item: Item) -> Result | Lost:
    with _ONE_AT_A_TIME:
        return attempt(function, item)


def _result(future: Any, scheduler: str) -> Any:
    """Return what a future gives; a result that died with its worker is waited for."""
    from concurrent.futures import CancelledError

    from distributed import KilledWorker

    try:
        return future.result()
    except CancelledError:
        raise ConnectionError(
            f"--scheduler {scheduler}: the connection was lost; what was finished is kept where a "
            "folder was named, and the same command goes on"
        ) from None
    except KilledWorker as error:
        return Lost(f"{ATTEMPTS} workers died with it, the last at {error.last_worker}", died=True)
    except Exception as error:
        return Lost(f"internal error, {type(error).__name__}: {error}")
