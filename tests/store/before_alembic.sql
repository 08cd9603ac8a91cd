CREATE TABLE api_keys (
	id VARCHAR(16) NOT NULL,
	name VARCHAR(200) NOT NULL,
	kind VARCHAR(8) NOT NULL,
	hash VARCHAR(64) NOT NULL,
	created_at DOUBLE PRECISION NOT NULL,
	expires_at DOUBLE PRECISION,
	revoked_at DOUBLE PRECISION,
	PRIMARY KEY (id)
);
CREATE TABLE holdings (
	scene_id VARCHAR(40) NOT NULL,
	owner VARCHAR(16) NOT NULL,
	bytes BIGINT NOT NULL,
	PRIMARY KEY (scene_id)
);
CREATE INDEX ix_holdings_owner ON holdings (owner);
CREATE TABLE operations (
	id VARCHAR(40) NOT NULL,
	scene_id VARCHAR(40) NOT NULL,
	state VARCHAR(16) NOT NULL,
	request_id VARCHAR(200),
	request_digest VARCHAR(64) NOT NULL,
	upload_id VARCHAR(40) NOT NULL,
	options JSON NOT NULL,
	stages JSON NOT NULL,
	error JSON,
	created_at DOUBLE PRECISION NOT NULL,
	updated_at DOUBLE PRECISION NOT NULL,
	attempt INTEGER NOT NULL,
	starts INTEGER NOT NULL,
	enqueued BOOLEAN NOT NULL,
	cancel_requested BOOLEAN NOT NULL,
	priority INTEGER DEFAULT '0' NOT NULL,
	PRIMARY KEY (id),
	UNIQUE (request_id)
);
CREATE INDEX ix_operations_state ON operations (state);
CREATE TABLE scene_versions (
	scene_id VARCHAR(40) NOT NULL,
	version VARCHAR(80) NOT NULL,
	number INTEGER NOT NULL,
	parent VARCHAR(80) NOT NULL,
	created_at DOUBLE PRECISION NOT NULL,
	request_id VARCHAR(200),
	request_digest VARCHAR(64) NOT NULL,
	gaussians INTEGER NOT NULL,
	dictionary JSON NOT NULL,
	edits JSON NOT NULL,
	PRIMARY KEY (scene_id, version),
	UNIQUE (scene_id, request_id)
);
CREATE TABLE scenes (
	id VARCHAR(40) NOT NULL,
	name VARCHAR(1000) NOT NULL,
	operation_id VARCHAR(40) NOT NULL,
	state VARCHAR(16) NOT NULL,
	version VARCHAR(80) NOT NULL,
	created_at DOUBLE PRECISION NOT NULL,
	gaussians INTEGER NOT NULL,
	scale VARCHAR(16) NOT NULL,
	dictionary JSON NOT NULL,
	cameras JSON NOT NULL,
	quality JSON NOT NULL,
	PRIMARY KEY (id)
);
CREATE INDEX scenes_newest_first ON scenes (created_at, id);
CREATE TABLE schema_version (
	version INTEGER NOT NULL,
	PRIMARY KEY (version)
);
CREATE TABLE workers (
	executor_id VARCHAR(80) NOT NULL,
	host VARCHAR(255) NOT NULL,
	pid INTEGER NOT NULL,
	started_at DOUBLE PRECISION NOT NULL,
	beat_at DOUBLE PRECISION NOT NULL,
	PRIMARY KEY (executor_id)
);
INSERT INTO scenes VALUES
	('done', 'desk', 'op_done', 'READY', 'v2', 1000.5, 6, 'METRIC', '[{"label_id": 1, "label": "mug"}]', '[]', '{"psnr": 30.0}'),
	('new', 'hall', 'op_new', 'TRAINING', '', 2000.5, 0, 'ARBITRARY', '[]', '[]', '{}');
INSERT INTO operations VALUES
	('op_done', 'done', 'SUCCEEDED', 'once', 'd', 'up_done', '{"labels": [], "admitted": "x", "time_budget_s": null, "max_gaussians": null, "preset": null}', '[]', NULL, 1000.5, 1100.5, 1, 1, true, false, 0),
	('op_new', 'new', 'QUEUED', NULL, 'd', 'up_new', '{"labels": ["mug"], "admitted": "x", "time_budget_s": 60.0, "max_gaussians": 500, "preset": "draft"}', '[]', NULL, 2000.5, 2000.5, 0, 0, false, false, 5);
INSERT INTO scene_versions VALUES
	('done', 'op_done', 1, '', 1000.5, NULL, '', 7, '[{"label_id": 1, "label": "mug"}]', '[]'),
	('done', 'v2', 2, 'op_done', 1200.5, 'edit', 'e', 6, '[{"label_id": 1, "label": "mug"}]', '[{"action": "remove"}]');
INSERT INTO api_keys VALUES ('0123456789ab', 'robot', 'read', 'abcd', 900.5, NULL, NULL);
INSERT INTO holdings VALUES ('done', '0123456789ab', 4096);
INSERT INTO workers VALUES ('host-1-aa', 'host', 1, 900.5, 1000.5);
INSERT INTO schema_version VALUES (2);
