"""One function on many items: in processes on this machine, or on a Dask cluster.

Results come as they are ready, each item's once, whatever becomes of single workers. What a worker
needs is sent to it and what it found is sent back, so nothing is assumed of a shared file system.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import multiprocessing
import os
import pickle
import secrets
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

import numpy as np

from .checks import count
from .errors import InvalidInputError, MissingExtraError, WorkerError

__all__ = ["Each", "pool", "threads"]

Each = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[tuple[int, Any]]]
"""Of a function and items, pairs of an item's index and its result, in the order of completion."""

_DEATHS = 3
"""So often an item is started anew after the death of a worker before its run is given up."""

_PATIENCE = 5.0
"""How long a scheduler may take to answer [s]."""

_UNGUARDED = (
    "a script must start workers below `if __name__ == '__main__':`, since each of them imports it"
)

_LOST = 30.0
"""How long a result that is ready may take to come [s]."""


@contextlib.contextmanager
def pool(workers: int = 1, cluster: str | None = None) -> Iterator[Each]:
    """Yield `each(function, items)`, which has the items worked on.

    Function and items are pickled; one worker is this very process, in which nothing is. An
    exception of the function is raised as itself and ends the rest.

    Args:
        workers: processes on this machine.
        cluster: address of a Dask scheduler, whose workers work instead; `local` starts a cluster
            of `workers` processes on this machine.

    Raises:
        InvalidInputError: an argument is out of its range.
        MissingExtraError: there is no Dask.
        WorkerError: no scheduler answers, or, of `each`, workers die again and again.
    """
    count("workers", workers)
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise WorkerError(_UNGUARDED)  # this process would start others, and those others
    if cluster is None:
        yield partial(_in_processes, workers)
        return
    if cluster != "local" and not cluster.startswith(("tcp://", "tls://")):
        raise InvalidInputError(
            f"cluster must be local or an address such as tcp://host:8786, got {cluster!r}"
        )
    if cluster != "local" and workers != 1:
        raise InvalidInputError(f"the cluster at {cluster} has its own workers: leave workers out")
    with _dask_client(workers, cluster) as client:
        yield partial(_on_dask, client)


@contextlib.contextmanager
def threads(number: int) -> Iterator[None]:
    """Compute on `number` threads of PyTorch within; as a decorator, within the function.

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

    # joblib renews a process that has grown, as it does when it loads a model, and warns of it.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
    sent, left, deaths = _Sent(function), dict(enumerate(items)), 0
    while left:
        run = Parallel(n_jobs=workers, return_as="generator_unordered")
        results: Any = run([delayed(_numbered)(sent, *entry) for entry in left.items()])
        try:
            for index, result in results:
                del left[index]
                deaths = 0
                yield index, result
        except BrokenProcessPool as cause:  # it takes the other workers' items with it
            deaths += 1
            if deaths > _DEATHS:
                raise WorkerError(_died(cause)) from cause
        finally:
            with warnings.catch_warnings(action="ignore"):  # joblib warns if it is not at its end
                results.close()


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
                    # It complains of each client that goes.
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
    """What is started within, threads and processes, never sees an interrupt from the keyboard."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # else the first process would start it, which lets them in
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _on_dask(
    client: Any, function: Callable[[Any], Any], items: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    from distributed import CancelledError, KilledWorker, TimeoutError, WorkerPlugin, as_completed

    class Holder(WorkerPlugin):
        """Hands the function to every worker, those too that come later or anew."""

        def __init__(self, sent: _Sent) -> None:
            self.sent = sent

        def setup(self, worker: Any) -> None:
            self.sent.held()

        def teardown(self, worker: Any) -> None:
            self.sent.drop()

    sent = _Sent(function)
    numbers: dict[str, int] = {}

    def started(index: int) -> Any:
        future = client.submit(_held, sent.key, items[index], pure=False)
        numbers[future.key] = index
        return future

    client.register_plugin(Holder(sent), name=sent.key)
    try:
        done = as_completed([started(i) for i in range(len(items))], loop=client.loop)
        for future in done:
            index = numbers.pop(future.key)
            try:
                result = future.result(timeout=_LOST)
            except TimeoutError:
                if future.status == "error":  # the function's own
                    raise
                done.add(started(index))  # the result died with its worker before it was sent
            else:
                yield index, result
    except KilledWorker as cause:
        raise WorkerError(_died(cause)) from cause
    except CancelledError as cause:
        raise WorkerError("the Dask scheduler does not answer any more") from cause
    finally:
        with contextlib.suppress(Exception):  # there may be nobody any more
            client.unregister_worker_plugin(sent.key)


def _died(cause: BaseException) -> str:
    return f"workers died again and again at the same work; is there enough memory? {cause}"


class _Sent:
    """A function on its way to workers: pickled once, unpickled once in each process."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self.key = secrets.token_hex(16)
        # joblib shares a large array.
        self.content = np.frombuffer(pickle.dumps(function), np.uint8)

    def __call__(self, item: Any) -> Any:
        _follow_the_main_process()
        if self.key not in _HELD:
            _HELD.clear()
        return self.held()(item)

    def held(self) -> Callable[[Any], Any]:
        """The function, which this process keeps."""
        if self.key not in _HELD:
            _HELD[self.key] = pickle.loads(self.content.data)
        return _HELD[self.key]

    def drop(self) -> None:
        """Keep it no longer."""
        _HELD.pop(self.key, None)


_HELD: dict[str, Callable[[Any], Any]] = {}
"""Of a worker, the functions that it was sent, by their keys."""

_LOCK = threading.Lock()
"""A worker of several threads has one model, and simulators that are not made for threads."""


@functools.cache
def _follow_the_main_process() -> None:
    """In a process of joblib, leave interrupts to the main one, and end with it.

    Where that one is killed, joblib's would wait for ever.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _held(key: str, item: Any) -> Any:
    with _LOCK:
        return _HELD[key](item)


def _numbered(function: Callable[[Any], Any], index: int, item: Any) -> tuple[int, Any]:
    return index, function(item)
