"""A mission: its items, where it stands, and what comes next."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.control.autopilot.requests import ItemKind, MissionItem


class Mission:
    """Items and progress of a mission.  ``current``: index of the present item; past the end the mission is done."""

    def __init__(self) -> None:
        self.items: tuple[MissionItem, ...] = ()
        self.restart(0)
        self.reached = -1

    def load(self, items: Sequence[MissionItem]) -> None:
        """Load a new mission and go to its first item."""
        self.items = tuple(items)
        self.restart(0)
        self.reached = -1

    def restart(self, index: int) -> None:
        """Continue at item ``index`` with all jumps reset."""
        self.current = index
        self.since = -1  # step at which the item began to wait
        self._jumps: dict[int, int] = {}

    @property
    def item(self) -> MissionItem | None:
        """The present item; None when the mission is done."""
        return self.items[self.current] if self.current < len(self.items) else None

    @property
    def done(self) -> bool:
        return self.current >= len(self.items)

    def describe_remaining(self) -> str:
        """Return which items have yet to be flown; empty: none."""
        count = len(self.items)
        return "" if self.done else f"mission left at item {self.current}: {count - self.current} of {count} not flown"

    def advance(self) -> MissionItem | None:
        """Advance to the next item to fly and return it; None at the end or in an endless loop."""
        self.reached = self.current
        self.since = -1
        self.current += 1
        return self.skip_jumps()

    def skip_jumps(self, max_jumps: int = 10_000) -> MissionItem | None:
        """Follow jumps from the present item, and pass items that are not flown; ``max_jumps`` in a row are endless."""
        for _ in range(max_jumps):
            item = self.item
            if item is not None and item.kind is ItemKind.LEFT_OUT:
                self.current += 1
                continue
            if item is None or item.kind is not ItemKind.JUMP or item.target is None:
                return item
            count = self._jumps.get(self.current, 0)
            if item.repeat < 0:
                self.current = item.target
            elif count < item.repeat:
                self._jumps[self.current] = count + 1
                self.current = item.target
            else:
                # A jump that is reached again after its last repetition starts counting anew.
                self._jumps[self.current] = 0
                self.current += 1
        self.current = len(self.items)
        return None


_INSTANT_ITEMS = (ItemKind.LEFT_OUT, ItemKind.SPEED, ItemKind.DELAY)  # items that take no flight time


def find_endless_jump(items: Sequence[MissionItem]) -> int | None:
    """Return the first endless jump that loops without flying or waiting."""
    for jump, first in enumerate(items):
        index, visited = jump, set[int]()
        while first.kind is ItemKind.JUMP and first.repeat < 0 and index < len(items):
            item = items[index]
            if index in visited:
                return jump
            visited.add(index)
            if item.kind is ItemKind.JUMP and item.repeat < 0 and item.target is not None:
                index = item.target
            elif item.kind in _INSTANT_ITEMS and not item.hold_s:
                index += 1
            else:
                break
    return None
