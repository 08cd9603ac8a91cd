"""Whether pictures of a project's things may go to the server's namer: agreed once, host by host, by an admin."""

from __future__ import annotations

from fastsplat.service.common.settings import environment_variable
from fastsplat.service.settings import NamerSettings, Settings
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError
from fastsplat_contract.name_suggestions import NamerStatus


def namer_status(store: Store, settings: Settings, project: str) -> NamerStatus | None:
    """The namer of the settings, and whether the project agreed to its host; None where there is none."""
    namer = settings.namer
    if not namer.url:
        return None
    return NamerStatus(namer.host, namer.model, store.projects.agreed(project) == namer.host)


def agree_to_namer(store: Store, settings: Settings, project: str, host: str) -> NamerStatus:
    """Agree to the host of the server's namer, or with "" to none; returns what holds then.

    Raises:
        ModelUnavailableError: the server has no namer.
        InvalidInputError: its host is another one: what was agreed to elsewhere does not hold for it.
    """
    namer = the_namer(settings)
    if host and host != namer.host:
        raise InvalidInputError(
            f"the server's namer is not at {host[:200]!r}", field="host", limit=f"{namer.host}, or empty"
        )
    store.projects.agree(project, host)
    return NamerStatus(namer.host, namer.model, bool(host))


def the_namer(settings: Settings) -> NamerSettings:
    """The settings of the server's namer.

    Raises:
        ModelUnavailableError: it has none.
    """
    if not settings.namer.url:
        raise ModelUnavailableError(
            "this server has no namer", field="namer", hint=f"Set {environment_variable(NamerSettings, 'url')}."
        )
    return settings.namer
