"""What an operator chooses: target, tracker, shadow, behaviour; driving by the page's own pad; landmarks."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from base_station.console.feed import Feed
from base_station.console.line import Lines
from base_station.orders import LANDMARK, Order
from base_station.publication.schema import State

NO_SHADOW = "none"
LONGEST_NAME = 64
PAD = """
<div class="pad" role="group" aria-label="drive">
  <button data-drive="forward" aria-label="forward">▲</button>
  <button data-drive="left" aria-label="turn left">◀</button>
  <button data-drive="backward" aria-label="backward">▼</button>
  <button data-drive="right" aria-label="turn right">▶</button>
</div>
"""


class Controls:
    """Build its three parts where they belong; then `show`."""

    def __init__(self, ui: Any, feed: Feed, lines: Lines) -> None:
        self._ui, self._feed, self._lines = ui, feed, lines
        self._names: tuple[str, ...] | None = None
        self._noticed: int | None = None

    def stage(self) -> None:
        """The picture with its buttons."""
        ui = self._ui
        with ui.element("div").classes("panel stage"):
            with ui.element("div").classes("room"):
                ui.element("div").classes("view").props("id=view")
            with ui.element("div").classes("view-foot orders"):
                ui.button("Whole view", on_click=lambda: self._order(kind="learn"))
                ui.label("or drag a box, or click").classes("soft")
                ui.html('<span id="rate" class="soft"></span>', sanitize=False).style("margin-left: auto")

    def choices(self) -> None:
        """Tracker, shadow, behaviour, driving."""
        ui = self._ui
        with ui.element("div").classes("panel choices orders"):
            with ui.element("div").classes("fields"):
                self._behaviour = self._select("behaviour", "Behaviour")
                self._tracker = self._select("tracker", "Tracker")
                self._shadow = self._select("shadow", "Shadow")
            with ui.element("div").classes("row").style("margin-top: 10px; flex-wrap: nowrap; gap: 14px"):
                ui.html(PAD, sanitize=False)
                self._hint = ui.label().classes("soft").style("flex: 1; min-width: 0")

    def landmarks(self) -> None:
        """Learn, go to, follow, forget; and what the station had to say."""
        ui = self._ui
        with ui.element("div").classes("panel landmarks orders"):
            with ui.element("div").classes("title"):
                ui.label("Landmarks")
            with ui.element("div").classes("row learn"):
                self._name = ui.input(placeholder="name").props(f"dense outlined maxlength={LONGEST_NAME}")
                self._name.props('aria-label="name of a landmark"')
                ui.button("Learn target", on_click=lambda: self._remember(whole=False)).props("outline dense no-wrap")
                ui.button("Learn view", on_click=lambda: self._remember(whole=True)).props("outline dense no-wrap")
            self._list = ui.element("div").classes("list")
        with ui.element("div").classes("panel messages hide") as self._messages:
            with ui.element("div").classes("title"):
                ui.label("Messages")
            self._notices = ui.element("div").classes("notices")

    def show(self, state: State) -> None:
        """Bring in what has changed."""
        landmarks = [LANDMARK + name for name in state.landmarks]
        self._offer(self._tracker, [*state.trackers, *landmarks], state.tracker)
        self._offer(self._shadow, [NO_SHADOW, *state.trackers, *landmarks], state.shadow_tracker or NO_SHADOW)
        self._offer(self._behaviour, list(state.behaviours), state.behaviour)
        teleop = state.behaviour == "teleop"
        self._hint.set_text(
            "Hold the arrows, W A S D, this pad or a gamepad's stick."
            if teleop
            else state.outcome or "To drive, choose the behaviour teleop."
        )
        if state.landmarks != self._names:
            self._names = state.landmarks
            self._fill_list(state.landmarks)
        self._tell(state)

    def _select(self, kind: str, label: str) -> Any:
        def chosen(event: Any) -> Any:
            return self._order(kind=kind, name="" if event.args == NO_SHADOW else str(event.args))

        made = self._ui.select([], label=label).props("dense outlined options-dense").props(f'data-choice="{kind}"')
        # not `on_change`: that would also tell of what the station says
        made.on(
            "update:model-value",
            chosen,
            js_handler="(choice) => { document.activeElement?.blur(); emit(choice.label); }",
        )
        return made

    def _offer(self, select: Any, names: list[str], chosen: str) -> None:
        if chosen and chosen not in names:
            names = [*names, chosen]
        if select.options != names or select.value != (chosen or None):
            select.set_options(names, value=chosen or None)

    def _fill_list(self, names: tuple[str, ...]) -> None:
        ui = self._ui
        self._list.clear()
        with self._list:
            if not names:
                ui.label("None yet. Give a name, and learn the target or the whole view.").classes("soft")
            for name in names:
                with ui.element("div").classes("item"):
                    ui.label(name)
                    for title, action in (("Go to", self._go_to), ("Follow", self._follow), ("Forget", self._forget)):
                        ui.button(title, on_click=_bound(action, name)).props("flat dense no-wrap")

    def _tell(self, state: State) -> None:
        newest = state.notices[-1].number if state.notices else 0
        if newest == (self._noticed or 0):
            self._noticed = newest
            return
        fresh = [notice.text for notice in state.notices if self._noticed is not None and notice.number > self._noticed]
        self._noticed = newest
        for text in fresh:
            self._say(text)
        self._messages.classes(remove="hide")
        self._notices.clear()
        with self._notices:
            for notice in reversed(state.notices):
                self._ui.label(notice.text)

    # -- orders ----------------------------------------------------------------------------------------------------

    async def _order(self, **fields: Any) -> None:
        try:
            wanted = Order(**fields)
        except ValueError as error:
            self._say(str(error), bad=True)
            return
        wrong = await self._lines.order(wanted)
        if wrong:
            self._say(wrong, bad=True)

    async def _remember(self, *, whole: bool) -> None:
        name, state = (self._name.value or "").strip(), self._feed.state
        if not name:
            self._say("Give the landmark a name first.", bad=True)
            return
        box = state.seen.box if state is not None and state.seen is not None else None
        if not whole and box is None:
            self._say("No target is seen just now: choose one in the picture, or learn the whole view.", bad=True)
            return
        await self._order(kind="remember", name=name, box=None if whole else box)
        self._name.set_value("")

    async def _go_to(self, name: str) -> None:
        await self._order(kind="tracker", name=LANDMARK + name)
        await self._order(kind="behaviour", name="goto")

    async def _follow(self, name: str) -> None:
        await self._order(kind="tracker", name=LANDMARK + name)
        await self._order(kind="behaviour", name="follow")

    async def _forget(self, name: str) -> None:
        error = await self._lines.forget(name)
        self._say(error or f"{name} is forgotten.", bad=bool(error))

    def _say(self, text: str, *, bad: bool = False) -> None:
        kind = "bad" if bad else "info"
        self._list.client.run_javascript(f"window.zservo?.toast({json.dumps(text)}, {json.dumps(kind)})")


def _bound(action: Callable[[str], Any], name: str) -> Callable[[], Any]:
    return lambda: action(name)
