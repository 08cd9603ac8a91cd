"""A day of many nodes beside many stored scenes: how much of what it has each shared part is asked for.

The database is simulated, see `simulation`. The rest is counted: requests that list the store, bytes through it, and
seconds in which servers open scenes. What a request and a connection to a store give is supposed, not measured here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from benchmarks.workers.simulation import Costs, Outcome, simulate

_DAY_S = 86_400.0
_NODE_HOURS = 1_200.0
"""Simulated; more say the same."""
_MINUTE_S, _HOUR_S = 60.0, 3600.0  # between two times that one worker cleans up for all, and lists all objects


@dataclass(frozen=True)
class Supposed:
    """What was not measured: an object store in the same data center, and who asks.

    Attributes:
        request_s: seconds of one request that lists names.
        names: in one answer.
        bytes_s: bytes a second between the store and all machines.
        opened: share of the stored scenes that is opened in a day, beside each new one.
        servers: of the API, of two cores each.
    """

    request_s: float = 0.1
    names: int = 1_000
    bytes_s: float = 1.25e9
    opened: float = 0.01
    servers: int = 2


@dataclass(frozen=True)
class Stored:
    """Scenes that are stored, and what was measured of one and of all.

    Attributes:
        scenes: how many.
        objects: of the store, of one scene.
        scene_bytes: of its files; its photos, as sent, are taken for as many.
        minute_s, hour_s: seconds of processors for one cleaning and one look at all objects, of the database and of the
            worker.
        opening_s: of a server's core, to open a scene and answer.
    """

    scenes: int
    objects: float
    scene_bytes: float
    minute_s: tuple[float, float]
    hour_s: tuple[float, float]
    opening_s: float


@dataclass(frozen=True)
class Day:
    """What was simulated, and counted.

    Attributes:
        queue: of the database's queue.
        shares: of what each part can do, that it is asked for; above 1 it cannot.
        first: the part with the highest share.
    """

    nodes: int
    queue: Outcome
    shares: Mapping[str, float]
    first: str


def day(nodes: int, costs: Costs, stored: Stored, supposed: Supposed = Supposed()) -> Day:
    """A day of nodes with one worker each, beside the scenes that are stored already."""
    queue = simulate(nodes, costs, hours=min(24.0, _NODE_HOURS / nodes))
    new = queue.jobs_a_day
    opened = new + supposed.opened * stored.scenes
    moved = (3 * new + opened) * stored.scene_bytes  # photos in and out to the worker, scenes in and out to servers
    listing_s = stored.scenes * (1 + stored.objects) / supposed.names * supposed.request_s  # scenes, then all objects
    shares = {
        "database": queue.database,
        "cleaning": sum(stored.minute_s) / _MINUTE_S,
        "listing": (listing_s + sum(stored.hour_s)) / _HOUR_S,
        "store": moved / supposed.bytes_s / _DAY_S,
        "opening": opened * stored.opening_s / (2 * supposed.servers) / _DAY_S,
    }
    return Day(nodes, queue, shares, max(shares, key=lambda part: shares[part]))
