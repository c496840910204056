"""`--console`: publishes a station or a replay, and opens a console on what is published."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from contextlib import ExitStack

from base_station.behaviours.registry import BEHAVIOURS
from base_station.console.launcher import ConsoleProcess, ConsoleSettings
from base_station.console.web import check_installed
from base_station.errors import StationError
from base_station.landmark_shelf import LandmarkShelf
from base_station.publication.service import OrderTaker, Publication
from base_station.publication.states import Choices, RobotView
from base_station.recording.replay import ReplayedRobot
from base_station.recording.replay_command import Audience, Watch
from base_station.station import Step
from base_station.trackers.base import Tracker
from base_station.trackers.registry import tracker_names

log = logging.getLogger(__name__)

POLL_S = 0.2


def check_console(settings: ConsoleSettings) -> None:
    """Find mistakes of usage before anything is opened. Raises StationError."""
    if not 1 <= settings.port <= 65535:
        raise StationError(f"--console-port must be 1..65535, not {settings.port}.", usage=True)
    check_installed()


def watching_console(settings: ConsoleSettings, say: Callable[[str], None]) -> Watch:
    """For a replay: opens a console that shows it; `say` gets the address. Raises StationError."""
    check_console(settings)

    def watch(stack: ExitStack, robot: ReplayedRobot) -> Audience:
        publication, console = _opened(stack, settings, robot, tracker=lambda: robot.tracker, say=say)
        audience = ReplayAudience(publication, console, robot, say)
        audience.wait_for_page()
        return audience

    return watch


class ReplayAudience:
    """Whoever looks at a replay's console. It begins with the first page and stays after the end, as players do."""

    def __init__(
        self, publication: Publication, console: ConsoleProcess, robot: ReplayedRobot, say: Callable[[str], None]
    ) -> None:
        self._publication, self._console, self._robot, self._say = publication, console, robot, say

    def wait_for_page(self) -> None:
        """Or for the console's early end. Raises KeyboardInterrupt."""
        self._say("The replay begins when this page is opened; Ctrl-C ends it.")
        while self._console.running and not self._console.opened(POLL_S):
            self._publication.wait()

    def step(self, step: Step) -> None:
        """A frame was dealt with."""
        self._publication.step(step)

    def stay(self) -> None:
        """Show the last picture until Ctrl-C, or the console's early end."""
        if not self._console.running:
            return
        self._robot.state += ", at its end"
        self._say("The replay is at its end, the console keeps its last picture; Ctrl-C ends it.")
        with contextlib.suppress(KeyboardInterrupt):
            while self._console.running:
                self._publication.hold()
                time.sleep(POLL_S)


def open_console(
    stack: ExitStack,
    settings: ConsoleSettings,
    robot: RobotView,
    *,
    orders: OrderTaker | None = None,
    shelf: LandmarkShelf | None = None,
    tracker: Callable[[], Tracker | None] = lambda: None,
    outcome: Callable[[], str] = lambda: "",
    own_trackers: tuple[str, ...] = (),
    begins: tuple[str, str] = ("", ""),
    say: Callable[[str], None] = log.info,
) -> Publication:
    """Until the stack ends; `say` gets the address. Call the publication's `step` and `wait` from the loop.

    `orders`: None for a replay, which takes none. `begins`: tracker and behaviour until the first frame. Raises
    StationError when there can be no console.
    """
    publication, _ = _opened(
        stack, settings, robot, orders=orders, shelf=shelf, tracker=tracker, outcome=outcome, own_trackers=own_trackers,
        begins=begins, say=say,
    )  # fmt: skip
    return publication


def _opened(
    stack: ExitStack,
    settings: ConsoleSettings,
    robot: RobotView,
    *,
    say: Callable[[str], None],
    orders: OrderTaker | None = None,
    shelf: LandmarkShelf | None = None,
    tracker: Callable[[], Tracker | None] = lambda: None,
    outcome: Callable[[], str] = lambda: "",
    own_trackers: tuple[str, ...] = (),
    begins: tuple[str, str] = ("", ""),
) -> tuple[Publication, ConsoleProcess]:
    trackers = tuple(dict.fromkeys((*own_trackers, *tracker_names())))

    def choices() -> Choices:
        return Choices(
            trackers=trackers,
            behaviours=tuple(BEHAVIOURS),
            landmarks=shelf.names if shelf else (),
            tracker=begins[0],
            behaviour=begins[1],
        )

    publication = Publication(
        robot,
        choices,
        orders=orders,
        tracker=tracker,
        outcome=outcome,
        forget=shelf.forget if shelf is not None else None,
        tick=shelf.refresh if shelf is not None else lambda: None,
    )
    stack.enter_context(publication)
    console = stack.enter_context(ConsoleProcess(publication.addresses.folder, settings))
    say(f"console: {console.address}")
    return publication, console
