"""Schema of the database. Times are seconds since 1970, UTC. How to change it: see `service.store.migrations`."""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Double,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    UniqueConstraint,
)

from fastsplat.service.store.records import DEFAULT_PROJECT

metadata = MetaData()


def _project() -> Column[str]:
    return Column("project", String(64), nullable=False, default=DEFAULT_PROJECT)


projects = Table(
    "projects",
    metadata,
    Column("name", String(64), primary_key=True),
    Column("created_at", Double, nullable=False),
    # The host of a namer to which pictures of its things may go; "": none.
    Column("namer_host", String(300), nullable=False, default=""),
)

scenes = Table(
    "scenes",
    metadata,
    Column("id", String(40), primary_key=True),
    Column("name", String(1000), nullable=False),
    Column("operation_id", String(40), nullable=False),
    Column("state", String(16), nullable=False),
    Column("version", String(80), nullable=False, default=""),
    Column("created_at", Double, nullable=False),
    Column("gaussians", Integer, nullable=False, default=0),
    Column("scale", String(16), nullable=False, default="ARBITRARY"),
    Column("dictionary", JSON, nullable=False),
    Column("cameras", JSON, nullable=False),
    Column("quality", JSON, nullable=False),
    # Of the current version: how its lengths follow from those of the trained one; null: they are the same.
    Column("scaling", JSON(none_as_null=True), nullable=True),
    Column("alignment", JSON(none_as_null=True), nullable=True),
    # Of the current version, as all above but the name; 0 as long as there is none.
    Column("things", Integer, nullable=False, default=0),
    _project(),
    Index("scenes_newest_first", "project", "created_at", "id"),
)

operations = Table(
    "operations",
    metadata,
    Column("id", String(40), primary_key=True),
    Column("scene_id", String(40), nullable=False),
    Column("state", String(16), nullable=False, index=True),
    # An idempotency key belongs to one request of a project; it is given back when its scene is deleted.
    Column("request_id", String(200), nullable=True),
    Column("request_digest", String(64), nullable=False),
    Column("upload_id", String(40), nullable=False),
    Column("options", JSON, nullable=False),
    Column("stages", JSON, nullable=False),
    Column("error", JSON(none_as_null=True), nullable=True),
    Column("created_at", Double, nullable=False),
    Column("updated_at", Double, nullable=False),
    # The fencing token: every claim increments it, and a write that carries an older number changes nothing.
    Column("attempt", Integer, nullable=False, default=0),
    # Starts since the job last came further than before that ended in a crash or have not ended; a release of the job
    # takes its start back.
    Column("starts", Integer, nullable=False, default=0),
    # The executor id of the worker that has it while it is RUNNING; "": others may claim it.
    Column("worker", String(80), nullable=False, default=""),
    Column("cancel_requested", Boolean, nullable=False, default=False),
    # Its training is to end early, and what is there to be kept.
    Column("finish_requested", Boolean, nullable=False, default=False),
    # What can be looked at while it runs, by kind; the bytes are in `Blobs.progress_file`.
    Column("progress_files", JSON(none_as_null=True), nullable=True),
    # Higher ones first.
    Column("priority", Integer, nullable=False, default=0),
    _project(),
    UniqueConstraint("project", "request_id", name="operations_request"),
)

workers = Table(
    "workers",
    metadata,
    Column("executor_id", String(80), primary_key=True),
    Column("host", String(255), nullable=False),
    Column("pid", Integer, nullable=False),
    Column("started_at", Double, nullable=False),
    Column("heartbeat_at", Double, nullable=False),
)

scene_versions = Table(
    "scene_versions",
    metadata,
    Column("scene_id", String(40), primary_key=True),
    Column("version", String(80), primary_key=True),
    Column("number", Integer, nullable=False),
    Column("parent", String(80), nullable=False, default=""),
    Column("created_at", Double, nullable=False),
    Column("request_id", String(200), nullable=True),
    Column("request_digest", String(64), nullable=False, default=""),
    Column("gaussians", Integer, nullable=False),
    Column("dictionary", JSON, nullable=False),
    Column("edits", JSON, nullable=False),
    # When it last ceased to be current; null: never. By it a redo knows which version was left.
    Column("current_at", Double, nullable=True),
    # The name of the key that made it; empty where there was none.
    Column("author", String(200), nullable=False, default=""),
    Column("scaling", JSON(none_as_null=True), nullable=True),
    Column("alignment", JSON(none_as_null=True), nullable=True),
    Column("quality", JSON, nullable=False),
    Column("things", Integer, nullable=False),
    UniqueConstraint("scene_id", "request_id"),
)

# What people named, with what it looks like; rows of each version of a scene, see `service.store.name_repository`.
known_names = Table(
    "known_names",
    metadata,
    Column("id", String(60), primary_key=True),
    Column("version", String(80), primary_key=True),
    Column("scene_id", String(40), nullable=False),
    Column("thing_id", Integer, nullable=False),
    Column("name", String(1000), nullable=False),
    Column("named_at", Double, nullable=False),
    Column("appearance", LargeBinary, nullable=False),
    Column("picture", LargeBinary, nullable=False),
    # What sources of suggestions had said of it: [source, probability, right] of each.
    Column("said", JSON, nullable=False, default=list),
    # Printed tags on it: [number, probability] of each.
    Column("tags", JSON, nullable=False, default=list),
    Index("known_names_of_version", "scene_id", "version"),
)

# Verdicts of a scene's photos as JSON objects, see `service.store.photo_repository`.
scene_photos = Table(
    "scene_photos", metadata, Column("scene_id", String(40), primary_key=True), Column("photos", JSON, nullable=False)
)

api_keys = Table(
    "api_keys",
    metadata,
    Column("id", String(16), primary_key=True),
    Column("name", String(200), nullable=False),
    Column("role", String(16), nullable=False),
    Column("hash", String(64), nullable=False),
    Column("created_at", Double, nullable=False),
    Column("expires_at", Double, nullable=True),
    Column("revoked_at", Double, nullable=True),
    # The operation that a key for one upload has made.
    Column("operation_id", String(40), nullable=True),
    _project(),
    # The one scene that the key shows; "" for all of the project.
    Column("scene_id", String(40), nullable=False, default=""),
)

# What each scene counts against the quotas of its project.
quota_usage = Table(
    "quota_usage",
    metadata,
    Column("scene_id", String(40), primary_key=True),
    Column("bytes", BigInteger, nullable=False),
)

# One row, see `service.store.identity`.
identity = Table(
    "identity",
    metadata,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("id", String(40), nullable=False),
)
