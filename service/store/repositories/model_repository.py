"""The choice of models in the database."""

from __future__ import annotations

from sqlalchemy import delete, insert, select

from fastsplat.service.common.setting_groups import ModelChoice
from fastsplat.service.store.rows.damaged_rows import is_object, require
from fastsplat.service.store.rows.database import Repository
from fastsplat.service.store.rows.schema import chosen_models


class ModelRepository(Repository):
    """The choice of models; each method is one transaction and may raise `DatabaseError`."""

    def chosen(self) -> ModelChoice:
        """Returns the choice; raises `ArtefactError` if a row is damaged."""
        with self._reading() as connection:
            rows = connection.execute(select(chosen_models)).all()
        for row in rows:
            require(f"model {row.role}", sha256=is_object(row.sha256))
        return {row.role: {"name": row.name, "sha256": row.sha256} for row in rows}

    def choose(self, choice: ModelChoice) -> None:
        """Replaces the whole choice; an empty one leaves all to the settings."""
        with self._writing() as connection:
            connection.execute(delete(chosen_models))
            for role, model in choice.items():
                connection.execute(insert(chosen_models).values(role=role, **model))
