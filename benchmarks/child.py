"""Questions answered by a child process, which is ended where it takes too long."""

from __future__ import annotations

import os
from multiprocessing import get_context

DIED = "its process died"


class Child:
    """A process that answers questions one by one, and keeps what it has made for the next one.

    ``answer(question)`` runs there; only the answers are sent, so that it may hold functions.
    """

    def __init__(self, answer):
        self._answer = answer
        self._begin()

    def _begin(self):
        context = get_context("fork")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_work, args=(self._answer, other), daemon=True)
        self._process.start()
        other.close()

    def ask(self, question, limit: float):
        """(answer, ""), or (None, why) where it took more than `limit` s or the process died; another then follows."""
        self._pipe.send(question)
        try:
            if self._pipe.poll(limit):
                return self._pipe.recv(), ""
        except EOFError:
            self._process.join()
        died = self._process.exitcode
        self.end()
        self._begin()
        return None, f"not done after {limit:g} s" if died is None else f"{DIED} ({died})"

    def end(self):
        self._process.kill()
        self._process.join()
        self._pipe.close()


def _work(answer, pipe):
    """Answer until the pipe is closed; what solvers print goes nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    while True:
        try:
            question = pipe.recv()
        except EOFError:
            return
        pipe.send(answer(question))
