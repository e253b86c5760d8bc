"""The main program of a worker process: reads tasks from stdin, answers on stdout, ends with its parent."""

import os
import sys
import traceback
from multiprocessing.connection import Connection

from keycld._errors import KeycldError
from keycld.systems.rendering import use_headless_gl


def main() -> None:
    """Answer tasks until the parent is gone."""
    use_headless_gl()
    tasks = Connection(os.dup(0), writable=False)
    answers = Connection(os.dup(1), readable=False)
    os.dup2(2, 1)  # what a library prints must not get between the answers
    while True:
        try:
            function, arguments = tasks.recv()
        except EOFError:
            return
        try:
            answer = function(*arguments)
        except KeycldError as error:
            answer = error
        except Exception:
            answer = RuntimeError(f"in a worker process:\n{traceback.format_exc()}")
        try:
            answers.send(answer)
        except BrokenPipeError:
            return


if __name__ == "__main__":
    sys.exit(main())
