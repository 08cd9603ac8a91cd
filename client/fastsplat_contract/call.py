"""What is declared of a call, and what it needs of its caller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Literal, NamedTuple, TypeVar, get_args

from fastsplat_contract.server.keys import Role

RequestT = TypeVar("RequestT")
ResponseT = TypeVar("ResponseT")
Tag = Literal["server", "scenes", "operations", "queries", "keys", "known names"]
_ROLES: tuple[Role, ...] = get_args(Role)
APART: tuple[Role, ...] = ("uploader", "suggester")
"""They do one task, and nothing else but to ask what they are."""


class Rule(NamedTuple):
    """A row of the access policy: what one call needs of its caller.

    Attributes:
        role: the least one that will do; None: no key is needed.
        long_lived: it waits or streams for long: it counts among its key's calls, not among those that compute.
        upload: it brings files, for as long as its sender takes.
        shared: a key of one scene may make it; that scene is then all that there is.
        also: of the roles that do one task and nothing else, "uploader" and "suggester", those that will do, too.
    """

    role: Role | None
    long_lived: bool = False
    upload: bool = False
    shared: bool = False
    also: tuple[Role, ...] = ()

    def allows(self, role: Role) -> bool:
        """Whether a caller of this role may make the call."""
        if role in APART:
            return self.role is None or role in self.also
        return self.role is None or _ROLES.index(role) >= _ROLES.index(self.role)


@dataclass(frozen=True)
class Call(Generic[RequestT, ResponseT]):
    """One call of the service.

    Attributes:
        rpc: its name in gRPC; REST's operations are called the same in snake_case.
        tag: the chapter of the REST API that it stands in.
        request: what is asked, with what REST has in the path; `None`'s type for nothing.
        response: what is answered; bytes for a file, `None`'s type for nothing.
        rule: who may make it.
        route: method and path of REST; "" for none.
        about: one or two sentences for people.
        also: further routes of REST that do the same in another form.
        pieces_in, pieces_out: the message of the gRPC stream that request or response come in; "" for one message.
        status: REST's: 201 of what its caller alone may keep, 202 of a job, whose place is told, 204 of nothing.
        body_optional: whether REST's body may be left out, which is then that of the type's defaults.
        repeatable: whether to make it twice does no more than to make it once.
        deprecated: what does the same, beginning with the name of a call, of one that goes with the next release; ""
            for one that stays. OpenAPI, the .proto and the header `Deprecation` say so.
    """

    rpc: str
    tag: Tag
    request: type[RequestT]
    response: type[ResponseT]
    rule: Rule
    route: str
    about: str
    also: tuple[str, ...] = ()
    pieces_in: str = ""
    pieces_out: str = ""
    status: Literal[200, 201, 202, 204] = 200
    body_optional: bool = False
    repeatable: bool = True
    deprecated: str = ""

    @property
    def said(self) -> str:
        """`about`, and what to use in its place."""
        return f"{self.about} Deprecated: use {self.deprecated}." if self.deprecated else self.about

    @property
    def routes(self) -> tuple[str, ...]:
        """All routes of REST."""
        return (self.route, *self.also) if self.route else ()
