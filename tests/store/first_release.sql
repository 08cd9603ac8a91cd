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
	PRIMARY KEY (id),
	UNIQUE (request_id)
);
CREATE INDEX ix_operations_state ON operations (state);
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
CREATE TABLE workers (
	executor_id VARCHAR(80) NOT NULL,
	host VARCHAR(255) NOT NULL,
	pid INTEGER NOT NULL,
	started_at DOUBLE PRECISION NOT NULL,
	beat_at DOUBLE PRECISION NOT NULL,
	PRIMARY KEY (executor_id)
);
INSERT INTO scenes VALUES
	('done', 'desk', 'op_done', 'READY', 'op_done', 1000.5, 7, 'METRIC', '[{"label_id": 1, "label": "mug"}]', '[]', '{"psnr": 30.0}'),
	('new', 'hall', 'op_new', 'TRAINING', '', 2000.5, 0, 'ARBITRARY', '[]', '[]', '{}');
INSERT INTO operations VALUES
	('op_done', 'done', 'SUCCEEDED', 'once', 'd', 'up_done', '{"labels": [], "admitted": "x"}', '[]', NULL, 1000.5, 1100.5, 1, 1, true, false),
	('op_new', 'new', 'QUEUED', NULL, 'd', 'up_new', '{"labels": ["mug"], "admitted": "x"}', '[]', NULL, 2000.5, 2000.5, 0, 0, false, false);
