"""The decoder of LAZ as a process of its own, that may die of a file.

It serves one request after the other, since it uses every core by itself. Where it dies, the file is refused, and the
next request starts another. It ends by itself when its parent does, in whatever way, since then its pipes end.
"""

import importlib.util
import itertools
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np

from bumpymap.core import UsageError
from bumpymap.readers import _decoder_child as words
from bumpymap.readers.decoder import DecoderError, Stream, StreamLostError, Supply, Table
from bumpymap.readers.shared import Block, Bytes, SharedMemory

__all__ = ["ChildDecoder"]

_SECONDS, _SECONDS_PER_BYTE = 4.0, 1e-7
"""Processor time that a request may take, and for each byte that goes in or comes out: ten times what files take."""
_FROM_OUTSIDE = {signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT}
_NOTHING = (0, 0)


class ChildDecoder:
    """A ``Decoder`` behind two pipes and shared memory; see `_decoder_child` for what is said through them."""

    def __init__(self) -> None:
        self._memory = SharedMemory()
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._numbers = itertools.count(1)
        self._streams: set[int] = set()
        """Of the child that runs."""

    def take(self, size: int) -> Block:
        """See ``Decoder``."""
        return self._memory.take(size)

    def check(self, record: bytes) -> None:
        """See ``Decoder``."""
        with self._lock:
            self._ask(words.CHECK, record=record)

    def chunk_table(self, record: bytes, data: Block, chunks: int) -> Table:
        """See ``Decoder``."""
        out = self._memory.take(16 * chunks)
        with self._lock:
            held = self._ask(words.TABLE, record=record, data=data.span, out=out.span)
        found = out.data.view(np.int64).reshape(-1, 2)[:held].tolist()
        return [(points, size) for points, size in found]

    def chunks(self, record: bytes, table: Table, data: Block, size: int) -> Bytes:
        """See ``Decoder``."""
        out = self._memory.take(size)
        with self._lock:
            self._ask(words.CHUNKS, record=record, table=table, data=data.span, out=out.span)
        return out.data

    def stream(self, record: bytes, supply: Supply, start: int, file_size: int) -> Stream:
        """See ``Decoder``."""
        number = next(self._numbers)
        with self._lock:
            self._ask(words.OPEN, number, record=record, data=(start, file_size), supply=supply)
            self._streams.add(number)
        return _ChildStream(self, number, supply)

    def read(self, number: int, size: int, supply: Supply) -> Bytes:
        """Bytes of the points that come next in a stream."""
        out = self._memory.take(size)
        with self._lock:
            if number not in self._streams or not self._runs():
                raise StreamLostError
            self._ask(words.READ, number, out=out.span, supply=supply)
        return out.data

    def drop(self, number: int) -> None:
        """Forget a stream."""
        with self._lock:
            if number in self._streams and self._runs():
                self._ask(words.CLOSE, number)
            self._streams.discard(number)

    def rest(self) -> None:
        """See ``Decoder``."""
        with self._lock:
            self._end()
            self._memory.trim()

    def abandon(self) -> None:
        """After a fork, in the new process: the child is not its own."""
        child, self._child = self._child, None
        if child is not None and child.stdin is not None and child.stdout is not None:
            os.close(child.stdin.fileno())
            os.close(child.stdout.fileno())
            child.stdin = child.stdout = None
            child.returncode = 0  # nothing to wait for

    def _ask(
        self,
        what: int,
        number: int = 0,
        *,
        record: bytes = b"",
        table: Table = (),
        data: tuple[int, int] = _NOTHING,
        out: tuple[int, int] = _NOTHING,
        supply: Supply | None = None,
    ) -> int:
        """Have something done; the caller holds the lock. Gives the number in the answer."""
        notes = self._memory.put(record), self._memory.put(np.array(table, np.int64).tobytes())
        most_us = int(1e6 * (_SECONDS + _SECONDS_PER_BYTE * (data[1] * (what == words.CHUNKS) + out[1])))
        spans = (*notes[0].span, *notes[1].span, *data, *out)
        try:
            child = self._running()
            self._send(child, words.REQUEST.pack(what, number, self._memory.size, most_us, *spans))
            while True:
                kind, first, second, text = self._answer(child)
                if kind != words.WANTED or supply is None:
                    break
                block = self._memory.take(second)
                got = supply(first, block.data)
                self._send(
                    child, words.REQUEST.pack(what, number, self._memory.size, 0, *[0] * 4, block.start, got, *_NOTHING)
                )
        except BaseException:
            # Whatever it was, nobody waits for the answer any more.
            self._end(kill=True)
            raise
        if kind == words.WRONG:
            raise DecoderError(text)
        return int(first)

    def _send(self, child: "subprocess.Popen[bytes]", data: bytes) -> None:
        try:
            os.write(child.stdin.fileno(), data)  # type: ignore[union-attr]
        except BrokenPipeError:
            self._mourn(child)

    def _answer(self, child: "subprocess.Popen[bytes]") -> tuple[int, int, int, str]:
        head = self._received(child, words.ANSWER.size)
        kind, first, second, size = words.ANSWER.unpack(head)
        return kind, first, second, self._received(child, size).decode("utf-8", "replace")

    def _received(self, child: "subprocess.Popen[bytes]", size: int) -> bytes:
        data = b""
        while len(data) < size:
            more = os.read(child.stdout.fileno(), size - len(data))  # type: ignore[union-attr]
            if not more:
                self._mourn(child)
            data += more
        return data

    def _mourn(self, child: "subprocess.Popen[bytes]") -> None:
        """Say what the child died of."""
        code = child.wait()
        if code >= 0:
            raise UsageError(
                f"the process that decodes LAZ ended by itself (code {code}): is lazrs installed as it should be? Try: "
                f"{sys.executable} -c 'import lazrs'"
            )
        name = signal.Signals(-code).name
        if -code in _FROM_OUTSIDE:
            raise UsageError(
                f"the process that decodes LAZ was killed ({name}), for want of memory? Lower `memory`, or end other "
                "programs, and run again"
            )
        if -code == signal.SIGPROF:
            raise DecoderError("the decoder comes to no end")
        raise DecoderError(f"the decoder breaks down ({name})")

    def _runs(self) -> bool:
        return self._child is not None and self._child.poll() is None

    def _running(self) -> "subprocess.Popen[bytes]":
        if self._child is None or self._child.poll() is not None:
            self._end(kill=True)
            self._child = self._start()
        return self._child

    def _start(self) -> "subprocess.Popen[bytes]":
        found = importlib.util.find_spec("lazrs")
        if found is None or found.origin is None:
            raise UsageError("LAZ cannot be decoded: lazrs is not installed. Install it with: pip install lazrs")
        # Without site-packages as a whole: what people put there is run at every start.
        places = [str(Path(__file__).parent), str(Path(found.origin).parents[1])]
        code = f"import sys; sys.path += {places!r}; import _decoder_child; _decoder_child.serve(int(sys.argv[1]))"
        try:
            return subprocess.Popen(  # noqa: S603 (this Python, and a script of this package)
                [sys.executable, "-I", "-S", "-c", code, str(self._memory.descriptor)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,  # panics are told as an answer
                bufsize=0,
                pass_fds=(self._memory.descriptor,),
                start_new_session=True,  # Ctrl-C is for the parent
            )
        except OSError as error:
            raise UsageError(
                f"cannot start a process to decode LAZ ({error.strerror}). End other programs, and run again"
            ) from error

    def _end(self, *, kill: bool = False) -> None:
        child, self._child = self._child, None
        self._streams.clear()
        if child is None:
            return
        if kill:
            child.kill()
        with child:  # closes the pipes, which ends it, and waits for it
            pass


class _ChildStream:
    def __init__(self, owner: ChildDecoder, number: int, supply: Supply) -> None:
        self._owner, self._number, self._supply = owner, number, supply

    def read(self, size: int) -> Bytes:
        return self._owner.read(self._number, size, self._supply)

    def close(self) -> None:
        self._owner.drop(self._number)
