"""Work in a thread of its own while somebody waits and is told so: for long jobs without OpenGL that let Python go."""

from collections.abc import Callable
from concurrent.futures import Future, wait
from threading import Thread
from typing import TypeVar

from glhybrid.timing import Progress

T = TypeVar("T")
TOLD_EVERY_S = 0.04


def run(work: Callable[[], T], progress: Progress | None, what: str) -> T:
    """The result of work(). progress is told of `what` again and again, as 0 of 0, until there is one.

    Without progress, work() is simply called. What work raises is raised here. What progress raises is too, at once:
    the work then ends on its own, unheard.
    """
    if progress is None:
        return work()
    done: Future[T] = Future()

    def carry_out() -> None:
        try:
            done.set_result(work())
        except BaseException as error:
            done.set_exception(error)

    Thread(target=carry_out, daemon=True, name=f"glhybrid: {what}").start()
    while not wait((done,), TOLD_EVERY_S).done:
        progress(what, 0, 0)
    return done.result()
