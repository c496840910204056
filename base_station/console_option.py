"""`--console`: publishes a station or a replay, and opens a console on what is published."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from base_station.behaviours.registry import BEHAVIOURS
from base_station.console.launcher import ConsoleProcess, ConsoleSettings
from base_station.console.web import check_installed
from base_station.errors import StationError
from base_station.landmark_shelf import LandmarkShelf
from base_station.publication.service import OrderTaker, Publication
from base_station.publication.states import Choices, RobotView
from base_station.recording.replay import ReplayedRobot
from base_station.recording.replay_command import Watch
from base_station.station import Step
from base_station.trackers.base import Tracker
from base_station.trackers.registry import tracker_names

log = logging.getLogger(__name__)


def check_console(settings: ConsoleSettings) -> None:
    """Find mistakes of usage before anything is opened. Raises StationError."""
    if not 1 <= settings.port <= 65535:
        raise StationError(f"--console-port must be 1..65535, not {settings.port}.", usage=True)
    check_installed()


def watching_console(settings: ConsoleSettings, say: Callable[[str], None]) -> Watch:
    """For a replay: opens a console that shows it; `say` gets the address. Raises StationError."""
    check_console(settings)

    def watch(stack: ExitStack, robot: ReplayedRobot) -> Sequence[Callable[[Step], None]]:
        return [open_console(stack, settings, robot, tracker=lambda: robot.tracker, say=say).step]

    return watch


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
    say: Callable[[str], None] = log.info,
) -> Publication:
    """Until the stack ends; `say` gets the address. Call the publication's `step` and `wait` from the loop.

    `orders`: None for a replay, which takes none. Raises StationError when there can be no console.
    """
    trackers = tuple(dict.fromkeys((*own_trackers, *tracker_names())))

    def choices() -> Choices:
        return Choices(trackers=trackers, behaviours=tuple(BEHAVIOURS), landmarks=shelf.names if shelf else ())

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
    return publication
