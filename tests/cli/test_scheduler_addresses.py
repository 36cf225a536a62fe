"""An address of a scheduler where something else answers, or nothing, is named in five seconds."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from metrocli.errors import InputError
from metrocli.uncertainty.workers import dask_client


@contextmanager
def answering(says: bytes) -> Iterator[int]:
    """Listen at a port and say something to whoever connects."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        held: list[socket.socket] = []

        def serve() -> None:
            try:
                while True:
                    held.append(server.accept()[0])
                    held[-1].sendall(says)
            except OSError:
                return

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]
        for one in held:
            one.close()


@pytest.mark.parametrize(
    ("says", "words"),
    [
        (b"", "it accepts the connection and is silent"),
        (b"SSH-2.0-OpenSSH_9.6\r\n", "begins with 'SSH-2.0-'"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "begins with 'HTTP/1.1'"),
    ],
)
def test_what_is_no_scheduler_is_named_in_time(says: bytes, words: str) -> None:
    begun = time.monotonic()
    with answering(says) as port, pytest.raises(InputError, match="no Dask scheduler answers there") as raised:
        dask_client.must_listen(f"tcp://127.0.0.1:{port}")
    assert words in str(raised.value)
    assert time.monotonic() - begun < 5
