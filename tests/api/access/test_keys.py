"""Keys by API: an admin makes, sees and takes back those of its project, an operator those of any."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from datetime import timedelta
from typing import get_args

import grpc
import pytest

from fastsplat.service.application.admin import project_keys
from fastsplat.service.application.service import SceneService
from fastsplat_client import Client, NotFoundError, PermissionDeniedError
from fastsplat_contract.codec.proto_codec import from_proto
from fastsplat_contract.errors import QuotaError
from fastsplat_contract.server.keys import NewKey, Role
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.clients import client_of
from tests.api.guarded import Guarded
from tests.api.served import Faces, rpc_refusal


@dataclass(frozen=True)
class _Place:
    """A server with two projects of the test's own."""

    faces: Faces
    service: SceneService
    project: str
    elsewhere: str
    operator: str

    def client(self, key: str, project: str = "") -> Client:
        return client_of(self.faces, key=key, project=project)

    def new(self, role: Role, project: str = "") -> tuple[str, str]:
        """Id and secret of a new key."""
        record, secret = self.service.admin.keys.create(role, role, project=project or self.project)
        return record.id, secret


@pytest.fixture
def place(guarded: Guarded) -> _Place:
    admin, project = guarded.service.admin, uuid.uuid4().hex[:8]
    for name in (project, f"{project}-elsewhere"):
        admin.projects.create(name)
    operator = admin.keys.create("first", "operator", project=project)[1]
    return _Place(guarded.faces, guarded.service, project, f"{project}-elsewhere", operator)


@pytest.mark.parametrize("caller", ["admin", "operator"])
@pytest.mark.parametrize("role", get_args(Role))
def test_nobody_makes_a_key_of_a_higher_role(place: _Place, caller: Role, role: Role) -> None:
    with place.client(place.new(caller)[1]) as client:
        if role == "operator" and caller == "admin":
            with pytest.raises(PermissionDeniedError) as refused:
                client.keys.create("new", role)
            assert refused.value.field == "role"
            assert [key.role for key in client.keys.all()] == ["admin"]
            return
        new_key = client.keys.create("new", role, 3_600.0)
    key = new_key.key
    assert (key.name, key.role, key.project, key.state) == ("new", role, place.project, "VALID")
    assert key.expires_at is not None and key.expires_at - key.created_at == timedelta(hours=1)
    assert new_key.secret not in repr(new_key) and key.id in new_key.secret
    with place.client(new_key.secret) as new:
        assert new.server_status().role == role


@pytest.mark.parametrize(("path", "body"), [("/v1/keys", {"name": "robot"}), ("/v1/upload-keys", {})])
def test_an_answer_with_a_secret_is_kept_by_no_cache(place: _Place, path: str, body: dict[str, str]) -> None:
    header = {"Authorization": f"Bearer {place.operator}"}
    response = place.faces.rest.post(path, json=body, headers=header)
    assert response.status_code == 201 and response.headers["cache-control"] == "no-store"
    assert place.faces.rest.post(path, headers=header).status_code == 400  # no key is made by accident


def test_a_secret_is_told_once_and_in_no_list(place: _Place) -> None:
    with place.client(place.new("admin")[1]) as client:
        new_key = client.keys.create("robot")
    response = place.faces.rest.get("/v1/keys", headers={"Authorization": f"Bearer {place.operator}"})
    assert new_key.key.id in response.text and "fsk_" not in response.text
    assert new_key.secret.rpartition("_")[2] not in response.text
    assert all(record.hash not in response.text for record in place.service.admin.keys.all())


def test_a_list_has_the_projects_keys_of_the_callers_role_at_most_page_by_page(place: _Place) -> None:
    admin_id, admin = place.new("admin")
    foreign_ids = {place.new("reader", place.elsewhere)[0], place.new("operator")[0]}
    with place.client(admin) as client:
        key_ids = [client.keys.create(f"robot {number}").key.id for number in range(5)]
        listed = [key.id for key in client.keys.all()]
        assert listed == [*reversed(key_ids), admin_id] and not foreign_ids & set(listed)
        first = place.faces.rest.get("/v1/keys?page_size=4", headers={"Authorization": f"Bearer {admin}"}).json()
        token = first["next_page_token"]
        rest = place.faces.rest.get(
            f"/v1/keys?page_size=4&page_token={token}", headers={"Authorization": f"Bearer {admin}"}
        ).json()
        assert [key["id"] for page in (first, rest) for key in page["keys"]] == listed
        assert rest["next_page_token"] == ""
    with place.client(place.operator) as operator:
        assert len(list(operator.keys.all())) == len(listed) + 2
    with place.client(place.operator, project=place.elsewhere) as operator:
        assert {key.project for key in operator.keys.all()} == {place.elsewhere}


def test_an_operator_makes_keys_of_a_project_it_names_and_nobody_else_does(place: _Place) -> None:
    with place.client(place.operator, project=place.elsewhere) as operator:
        assert operator.keys.create("new", "admin").key.project == place.elsewhere
        metadata = (("authorization", f"Bearer {place.operator}"), ("x-fastsplat-project", place.elsewhere))
        new_key = from_proto(NewKey, place.faces.rpc.CreateKey(pb.CreateKeyRequest(name="x"), metadata=metadata))
        assert (new_key.key.project, new_key.key.role) == (place.elsewhere, "editor")
    with place.client(place.new("admin")[1], project=place.elsewhere) as admin, pytest.raises(NotFoundError):
        admin.keys.create("new")


@pytest.mark.parametrize("of", ["operator", "admin of another project", "nobody"])
def test_keys_beyond_the_callers_reach_do_not_exist_for_it(place: _Place, of: str) -> None:
    key_id = {
        "operator": place.new("operator")[0],
        "admin of another project": place.new("admin", place.elsewhere)[0],
        "nobody": "0123456789ab",
    }[of]
    metadata = (("authorization", f"Bearer {place.new('admin')[1]}"),)
    with place.client(place.new("admin")[1]) as admin, pytest.raises(NotFoundError, match=f"no key '{key_id}'"):
        admin.keys.revoke(key_id)
    with pytest.raises(grpc.RpcError) as refused:
        place.faces.rpc.RevokeKey(pb.RevokeKeyRequest(key_id=key_id), metadata=metadata)
    assert rpc_refusal(refused.value).reason == "NOT_FOUND"
    record = place.service._store.keys.find(key_id)
    assert record is None or record.revoked_at is None


def test_a_key_that_is_over_stays_so(place: _Place) -> None:
    with place.client(place.operator) as operator:
        key = operator.keys.create("robot", "reader", 60.0).key
        revoked = operator.keys.revoke(key.id)
        assert revoked.state == "REVOKED" and operator.keys.revoke(key.id) == revoked


def test_a_project_has_so_many_keys_and_no_more(place: _Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(project_keys, "MAX_KEYS", 3)
    with place.client(place.new("admin")[1]) as admin:
        admin.keys.revoke(admin.keys.create("short").key.id)
        with pytest.raises(QuotaError):
            admin.keys.create("one more")
    with place.client(place.operator, project=place.elsewhere) as operator:
        assert operator.keys.create("there is room").key.project == place.elsewhere
