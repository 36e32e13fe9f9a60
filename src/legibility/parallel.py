"""One function on many items: in processes on this machine, or on a Dask cluster.

Results come as they are ready, each once, even if workers die. Function, items and results travel
by pickle, so no shared file system is needed.
"""

import contextlib
import functools
import logging
import multiprocessing
import os
import pickle
import signal
import socket
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import resource_tracker
from typing import Any

from .checks import count, did_you_mean
from .errors import InvalidInputError, MissingExtraError, WorkerError

Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[int, Any]]]
"""From a function and items to pairs of an item's index and its result, in order of completion."""

_DEATHS = 3
"""How often joblib's workers may die in a row before the run ends; Dask's default is the same."""

_PATIENCE = 5.0
"""Time for a scheduler to answer [s]."""

_LOST = 30.0
"""Time for a finished result to arrive [s]."""

_LOG = logging.getLogger(__name__)

_UNGUARDED = (
    "a script must start workers below `if __name__ == '__main__':`, since each of them imports it"
)

_LOCK = threading.Lock()
"""Held while an item is worked on: models and simulators are not thread-safe."""


@contextlib.contextmanager
def pool(workers: int = 1, cluster: str | None = None) -> Iterator[Each]:
    """Yield `each(function, items)`, see `Each`.

    With one worker and no cluster, the function runs in this process, without pickling. An
    exception of the function is raised unchanged and ends the run.

    Args:
        workers: processes on this machine.
        cluster: address of a Dask scheduler whose workers to use; `local` starts a cluster of
            `workers` processes on this machine.

    Raises:
        InvalidInputError: an argument is out of its range.
        MissingExtraError: Dask is not installed.
        WorkerError: no scheduler answers, or, from `each`, workers die repeatedly.
    """
    count("workers", workers)
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise WorkerError(_UNGUARDED)  # this process would start others, and those others
    _LOG.info("work is done by %s", cluster or f"{workers} processes")
    if cluster is None:
        yield partial(_in_processes, workers)
        return
    if cluster != "local" and not cluster.startswith(("tcp://", "tls://")):
        raise InvalidInputError(
            f"cluster must be local or an address such as tcp://host:8786, got {cluster!r}"
            f"{did_you_mean(cluster, ['local'])}"
        )
    if cluster != "local" and workers != 1:
        raise InvalidInputError(f"the cluster at {cluster} has its own workers: leave workers out")
    with _dask_client(workers, cluster) as client:
        yield partial(_on_dask, client)


@contextlib.contextmanager
def threads(number: int) -> Iterator[None]:
    """Limit PyTorch to `number` threads in a `with` block or a decorated function.

    The number of threads changes times and the last digits of results. Both backends obey it.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _in_processes(
    workers: int, function: Callable[[Any], Any], items: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    if workers == 1:
        yield from enumerate(map(function, items))
        return
    from joblib import Parallel, delayed

    # joblib replaces a process that has grown, as it does when it loads a model, and warns of it.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
    content, left, deaths = pickle.dumps(function), dict(enumerate(items)), 0
    while left:
        run = Parallel(n_jobs=workers, return_as="generator_unordered")
        results: Any = run([delayed(_in_process)(content, *entry) for entry in left.items()])
        try:
            for index, result in results:
                del left[index]
                deaths = 0
                yield index, result
        except BrokenProcessPool as cause:  # one death ends the other workers' items too
            deaths += 1
            if deaths > _DEATHS:
                raise _died(cause) from cause
        finally:
            with warnings.catch_warnings(action="ignore"):  # joblib warns of unread results
                results.close()


def _in_process(content: bytes, index: int, item: Any) -> tuple[int, Any]:
    _follow_the_main_process()
    return index, _work(content, item)


@functools.cache
def _follow_the_main_process() -> None:
    """In a process of joblib: ignore interrupts, and exit when the main process is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _work(content: bytes, item: Any) -> Any:
    with _LOCK:
        return _unpickled(content)(item)


@functools.lru_cache(maxsize=1)
def _unpickled(content: bytes) -> Callable[[Any], Any]:
    """The function, unpickled once in each process."""
    return pickle.loads(content)


@contextlib.contextmanager
def _dask_client(workers: int, cluster: str) -> Iterator[Any]:
    try:
        from distributed import Client, LocalCluster
        from distributed.comm.addressing import parse_host_port
    except ImportError as cause:
        raise MissingExtraError(
            "dask is not installed: pip install 'legibility[cluster]'"
        ) from cause
    address: Any = cluster
    with contextlib.ExitStack() as stack:
        try:
            if cluster == "local":
                with _interrupts_held_back():
                    # silence_logs: it warns of every client that leaves
                    address = LocalCluster(n_workers=workers, threads_per_worker=1,
                                           dashboard_address=None,  # pyright: ignore
                                           silence_logs=logging.CRITICAL + 1)  # fmt: skip
                stack.enter_context(address)
            else:  # a client that was never connected could not be closed
                place = parse_host_port(cluster.partition("://")[2])
                socket.create_connection(place, _PATIENCE).close()
            client = stack.enter_context(Client(address, timeout=_PATIENCE, set_as_default=False))
        except RuntimeError as cause:
            raise WorkerError(
                f"the local cluster did not start: {cause} Note: {_UNGUARDED}"
            ) from cause
        except (OSError, ValueError) as cause:
            raise WorkerError(f"no Dask scheduler answers at {cluster}: {cause}") from cause
        yield client


@contextlib.contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Threads and processes started in the block ignore interrupts from the keyboard."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # started by the first process, it would unblock them
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _on_dask(
    client: Any, function: Callable[[Any], Any], items: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    from distributed import CancelledError, KilledWorker, TimeoutError, as_completed

    # A task, not scattered data: Dask makes it again if all workers that hold it leave.
    content = client.submit(bytes, pickle.dumps(function), pure=False)
    numbers: dict[str, int] = {}

    def started(index: int) -> Any:
        future = client.submit(_work, content, items[index], pure=False)
        numbers[future.key] = index
        return future

    try:
        done = as_completed([started(i) for i in range(len(items))], loop=client.loop)
        for future in done:
            index = numbers.pop(future.key)
            try:
                result = future.result(timeout=_LOST)
            except TimeoutError:
                if future.status == "error":  # raised by the function
                    raise
                done.add(started(index))  # the result was lost with its worker
            else:
                yield index, result
    except KilledWorker as cause:
        raise _died(cause) from cause
    except CancelledError as cause:
        raise WorkerError("the Dask scheduler no longer answers") from cause


def _died(cause: BaseException) -> WorkerError:
    return WorkerError(
        f"workers died again and again at the same work; is there enough memory? {cause}"
    )
