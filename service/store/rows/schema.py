"""Database schema; times are seconds since 1970, UTC. `service.store.rows.migrations` says how to change it."""

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
    literal_column,
)

from fastsplat.service.store.rows.records import DEFAULT_PROJECT

metadata = MetaData()


def _project() -> Column[str]:
    return Column("project", String(64), nullable=False, default=DEFAULT_PROJECT)


projects = Table(
    "projects",
    metadata,
    Column("name", String(64), primary_key=True),
    Column("created_at", Double, nullable=False),
    Column("captioner_host", String(300), nullable=False, default=""),  # may receive pictures of objects; "": none
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
    # Change of lengths from the trained version to the current one; null: none.
    Column("scaling", JSON(none_as_null=True), nullable=True),
    Column("alignment", JSON(none_as_null=True), nullable=True),
    Column("objects", Integer, nullable=False, default=0),
    _project(),
    Index("scenes_newest_first", "project", "created_at", "id"),
)

operations = Table(
    "operations",
    metadata,
    Column("id", String(40), primary_key=True),
    Column("scene_id", String(40), nullable=False),
    Column("state", String(16), nullable=False),
    Column("request_id", String(200), nullable=True),  # idempotency key; freed when the scene is deleted
    Column("request_digest", String(64), nullable=False),
    Column("upload_id", String(40), nullable=False),
    Column("options", JSON, nullable=False),
    Column("kind", String(40), nullable=False, server_default=""),
    Column("order", JSON, nullable=False, server_default="{}"),
    Column("result", JSON(none_as_null=True), nullable=True),
    Column("retries", Integer, nullable=False, server_default="0"),
    Column("excluded", JSON, nullable=False, server_default="[]"),
    Column("stages", JSON, nullable=False),
    Column("error", JSON(none_as_null=True), nullable=True),
    Column("created_at", Double, nullable=False),
    Column("updated_at", Double, nullable=False),
    # Fencing token: every claim increments it, and writes that carry an older one change nothing.
    Column("attempt", Integer, nullable=False, default=0),
    Column("starts", Integer, nullable=False, default=0),  # since it last made progress; released ones do not count
    Column("worker", String(80), nullable=False, default=""),  # executor id; "": it may be claimed
    Column("run_after", Double, nullable=False, server_default="0"),  # nobody claims it before
    Column("again_after", String(16), nullable=True),  # see `OperationRecord`, as are the next three
    Column("gpus", Integer, nullable=False, server_default="0"),
    Column("memory", BigInteger, nullable=False, server_default="0"),
    Column("models", JSON, nullable=False, server_default="{}"),
    Column("cancel_requested", Boolean, nullable=False, default=False),
    Column("finish_requested", Boolean, nullable=False, default=False),  # end training early, keeping its result
    Column("progress_files", JSON(none_as_null=True), nullable=True),  # by kind; see `OperationRecord`
    Column("priority", Integer, nullable=False, default=0),
    _project(),
    UniqueConstraint("project", "request_id", name="operations_request"),
    Index("operations_by_state", "state", "project"),
    Index("operations_by_upload", "upload_id"),
)

# A literal, as neither database proves by a bound value that a query may use the partial index.
QUEUED = operations.c.state == literal_column("'QUEUED'")
QUEUE_ORDER = operations.c.priority.desc(), operations.c.created_at, operations.c.id
Index("operations_queued", operations.c.project, *QUEUE_ORDER, sqlite_where=QUEUED, postgresql_where=QUEUED)

attempts = Table(
    "attempts",
    metadata,
    Column("operation_id", String(40), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("worker", String(80), nullable=False),
    Column("began_at", Double, nullable=False),
    Column("ended_at", Double, nullable=True),
    Column("why", String(16), nullable=True),
)

# When a job of each project was last claimed.
turns = Table(
    "turns", metadata, Column("project", String(64), primary_key=True), Column("last_at", Double, nullable=False)
)

# Work that workers share: until when nobody else does it.
leases = Table(
    "leases", metadata, Column("name", String(40), primary_key=True), Column("until", Double, nullable=False)
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
    # Time at which it last ceased to be current (null: never), by which a redo finds the version to return to.
    Column("current_at", Double, nullable=True),
    Column("author", String(200), nullable=False, default=""),  # name of the access key; "": none
    Column("scaling", JSON(none_as_null=True), nullable=True),
    Column("alignment", JSON(none_as_null=True), nullable=True),
    Column("quality", JSON, nullable=False),
    Column("objects", Integer, nullable=False),
    UniqueConstraint("scene_id", "request_id"),
)

# Names given by people, with the appearance of the object, for each version of a scene.
known_names = Table(
    "known_names",
    metadata,
    Column("id", String(60), primary_key=True),
    Column("version", String(80), primary_key=True),
    Column("scene_id", String(40), nullable=False),
    Column("object_id", Integer, nullable=False),
    Column("name", String(1000), nullable=False),
    Column("named_at", Double, nullable=False),
    Column("appearance", LargeBinary, nullable=False),
    Column("picture", LargeBinary, nullable=False),
    Column("said", JSON, nullable=False, default=list),  # suggested names: [source, probability, right]
    Column("tags", JSON, nullable=False, default=list),  # printed tags: [number, probability]
    Index("known_names_of_version", "scene_id", "version"),
)

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
    Column("operation_id", String(40), nullable=True),  # made with a key for one upload
    _project(),
    Column("scene_id", String(40), nullable=False, default=""),  # the only scene that it gives access to; "": all
)

# Bytes of each scene that count against the quota of its project.
quota_usage = Table(
    "quota_usage",
    metadata,
    Column("scene_id", String(40), primary_key=True),
    Column("bytes", BigInteger, nullable=False),
)

resumable_uploads = Table(
    "resumable_uploads",
    metadata,
    Column("id", String(40), primary_key=True),
    _project(),
    Column("key_id", String(16), nullable=False),
    Column("name", String(4096), nullable=False),
    Column("length", BigInteger, nullable=False),
    Column("metadata", String(4096), nullable=False),
    Column("expires_at", Double, nullable=False),
    Column("offset", BigInteger, nullable=False),
    Column("pieces", JSON, nullable=False),
)

chosen_models = Table(
    "chosen_models",
    metadata,
    Column("role", String(40), primary_key=True),
    Column("name", String(200), nullable=False),
    Column("sha256", JSON, nullable=False),  # by file name
)

identity = Table(
    "identity",
    metadata,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("id", String(40), nullable=False),
)
