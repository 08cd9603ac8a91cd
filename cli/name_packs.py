"""`fastsplat things check-names`, `export-names`, `add-names`: how well names are known again, and files of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.export import write_file
from fastsplat.cli.options import service_command
from fastsplat.cli.session import Session
from fastsplat.cli.tables import Column, table
from fastsplat.cli.thing_commands import things_app
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.json_codec import from_json, to_json
from fastsplat_contract.known_names import KindCheck, NamePack

_MOST_BYTES = 64 * 2**20
_Pack = Annotated[Path, typer.Argument(help="A pack of names.", exists=True, dir_okay=False)]


@service_command(things_app, "check-names")
def check_names(
    session: Session,
    pack: Annotated[
        Path | None, typer.Option(help="Check these names, too, before they are added.", exists=True, dir_okay=False)
    ] = None,
) -> None:
    """Show how well the project's names are known again in scenes left out in turn."""
    told = session.client.known_names.check(None if pack is None else _read(pack))
    total = KindCheck("all", sum(each.examples for each in told.kinds), told.borne, told.suggested, told.right)
    columns = (Column("name", "cut"), *(Column(name, right=True) for name in ("known", "found", "right")))
    rows = [
        (each.name, str(each.examples), f"{each.right} of {each.borne}", f"{each.right} of {each.suggested}")
        for each in (*told.kinds, total)
    ]
    session.tell(told, table(columns, rows if told.kinds else ()), nothing="no names are known by looks")


@service_command(things_app, "export-names")
def export_names(
    session: Session,
    file: Annotated[Path, typer.Argument(help="Where to write the pack.", dir_okay=False)],
    license_text: Annotated[
        str, typer.Option("--license", help="Under which others may use it: a name, as CC0-1.0, or a whole text.")
    ],
) -> None:
    """Write what the project knows by looks into a file, without pictures and scenes, for another project or server."""
    pack = session.client.known_names.export_pack(license_text)
    write_file(file, to_json(pack))
    session.tell(pack, f"{len(pack.names)} names with features of {pack.model}")


@service_command(things_app, "add-names")
def add_names(session: Session, file: _Pack) -> None:
    """Suggest the names of a pack in the project's scenes; `things known --forget ID` takes it back."""
    added = session.client.known_names.add_pack(_read(file))
    session.tell(added, f"pack {added.id}: {added.names} names, license {added.license[:80]}")


def _read(file: Path) -> NamePack:
    if file.stat().st_size > _MOST_BYTES:
        raise InvalidInputError(f"{file} is too large", field="FILE", limit=f"{_MOST_BYTES} bytes")
    return from_json(NamePack, file.read_bytes())
