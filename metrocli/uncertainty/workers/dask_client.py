"""Connections to a Dask scheduler: what an address means, whether a scheduler answers there, and its certificates."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import Any, TypeVar

from metrocli.errors import Fault, InputError

T = TypeVar("T")
PATIENCE_S = 2.5
"""Longest time for a scheduler to answer [s]"""
_LONGEST_HELLO = 1 << 20
"""Bytes that the handshake of a scheduler has at most"""
_ADDRESSES, _ENCRYPTED = ("tcp://", "tls://", "ucx://", "ws://", "wss://"), ("tls://", "wss://")


def must_listen(address: str) -> None:
    """Raise InputError if nothing listens at tcp://HOST:PORT; checked before the slow import of the library."""
    import socket
    from urllib.parse import urlsplit

    try:
        url = urlsplit(address)
        # 8786 is the port of Dask schedulers
        with socket.create_connection((url.hostname, url.port or 8786), PATIENCE_S) as connection:
            connection.settimeout(PATIENCE_S)
            # a scheduler speaks first: the length of its handshake as 8 bytes, which is small; with TLS it waits
            head = connection.recv(8, socket.MSG_WAITALL) if url.scheme == "tcp" else b""
    except TimeoutError as error:
        raise _unanswered(address, TimeoutError("it accepts the connection and is silent")) from error
    except (OSError, ValueError) as error:
        raise _unanswered(address, error) from error
    if url.scheme == "tcp" and not 0 < int.from_bytes(head, "little") < _LONGEST_HELLO:
        begins = head.split(b"\r")[0].decode("ascii", "replace")
        raise _unanswered(address, ValueError(f"what answers begins with '{begins}'" if head else "it hangs up"))


def _unanswered(address: str, error: Exception) -> InputError:
    hint = "one with TLS has an address tls://HOST:PORT" if address.startswith("tcp://") else None
    return InputError([Fault(f"--scheduler {address}: no Dask scheduler answers there ({error})", hint=hint)])


def _address_in(path: str) -> str:
    """Return the address that a scheduler file holds."""
    if not os.path.isfile(path):
        raise InputError(f"--scheduler {path}: no such scheduler file; write tcp://HOST:PORT or the path of one")
    try:
        with open(path, encoding="utf-8") as file:
            return str(json.load(file)["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"--scheduler {path}: this is not a scheduler file of Dask ({error})") from error


def _silence() -> None:
    """Keep from the terminal what the library writes for those who program with it.

    That is its tracebacks when a cluster is lost, which errors state in words, and its advice on large files.
    """
    import logging
    import warnings

    warnings.filterwarnings("ignore", "Sending large graph", UserWarning)

    # its configuration gives some of its loggers levels of their own
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)


def _security(library: Any, address: str) -> Any:
    """Return the security of Dask's own configuration; raise InputError if it lacks what an encrypted address needs."""
    security = library.Security()
    hint = "state ca-file, client.cert and client.key under distributed.comm.tls in the configuration of Dask"
    try:
        context = security.get_connection_args("client").get("ssl_context")
    except OSError as error:
        files = ", ".join(filter(None, (security.tls_ca_file, security.tls_client_cert, security.tls_client_key)))
        message = f"--scheduler {address}: the certificates {files} cannot be used ({error})"
        raise InputError([Fault(message, hint=hint)]) from error
    if address.startswith(_ENCRYPTED) and context is None:
        raise InputError(
            [Fault(f"--scheduler {address}: the scheduler uses TLS, and no certificate is given", hint=hint)]
        )
    return security


def client_of(scheduler: str) -> Any:
    """Return a client of a running cluster, or raise InputError in a few seconds."""
    address = scheduler if scheduler.startswith(_ADDRESSES) else _address_in(scheduler)
    if address.startswith(("tcp://", "tls://")):
        must_listen(address)
    try:
        import distributed
    except ImportError as error:
        raise InputError("--scheduler needs the library 'distributed': pip install 'metrocli[cluster]'") from error
    library: Any = distributed
    _silence()
    security = _security(library, address)
    return _in_time(address, lambda: library.Client(address, timeout=PATIENCE_S, security=security))


def _in_time(address: str, connect: Callable[[], T]) -> T:
    """Return what a connection returns, or raise InputError after 2 PATIENCE_S: the library may wait without end."""
    import threading

    answers, failed = list[T](), list[Exception]()

    def work() -> None:
        try:
            answers.append(connect())
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(2 * PATIENCE_S)
    if answers:
        return answers[0]
    if failed and not isinstance(failed[0], OSError | TimeoutError | ValueError):
        raise failed[0]
    error = failed[0] if failed else TimeoutError(f"the handshake has not ended after {2 * PATIENCE_S:g} s")
    raise _unanswered(address, error) from error
