"""Questions in plain words and their answers; pictures of a view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import AfterValidator, Field

from fastsplat_contract.codec.wire import Base64, Carried, Int64, Many, Request, Response, Some, checked, travels
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Pose
from fastsplat_contract.jobs.job_watching import Provisional
from fastsplat_contract.masks import Mask3dEncoding, MaskEncoding, ViewMask
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.phrases import PhraseAnswer
from fastsplat_contract.messages.scenes import OfScene, Version

Output = Literal["mask2d", "mask3d", "objects"]
Outcome = Literal["here", "probably_here", "not_here", "not_seen", "cannot_say"]
Relation = Literal["same", "kind_of", "part_of", "related", "absent", "undecided"]
RelationSubject = Literal["label", "question"]
AnswerMethod = Literal["lexicon", "encoder", "names"]


def check_coverage(coverage: float) -> float:
    """A coverage that can be asked for: above 0 and below 1.

    Raises:
        InvalidInputError: it is not, or no number.
    """
    if isinstance(coverage, bool) or not isinstance(coverage, (int, float)) or not 0.0 < coverage < 1.0:
        raise InvalidInputError(
            f"a coverage of {coverage!r}", field="coverage", limit="above 0 and below 1", hint="Send a share, e.g. 0.9."
        )
    return float(coverage)


@dataclass(frozen=True)
class QueryIn(Request):
    """Questions to one scene."""

    proto: ClassVar[str] = "QueryRequest"

    texts: Annotated[Many[str], Field(description="at least one")]
    cameras: Annotated[Many[PosedCamera], Field(description="free viewpoints for 2D masks")] = ()
    views: Annotated[Many[str], Field(description="names of the scene's own cameras for 2D masks")] = ()
    outputs: Annotated[
        Some[Output],
        Field(
            description="what to compute beside the ranking. mask2d: a 2D mask per text and camera or view, which it "
            "needs; mask3d: a 3D mask per text; objects: the objects that answer, as boxes"
        ),
    ] = frozenset()
    version: Version = ""
    negatives: Annotated[Many[str], Field(description="canonical negatives of the relevancy; empty: the server's")] = ()
    templates: Annotated[
        Many[str], Field(description="sentences with one {} that texts are put into; empty: the server's")
    ] = ()
    coverage: Annotated[
        Annotated[float, AfterValidator(checked(check_coverage))] | None,
        Field(
            description="of the label set, above 0 and below 1; absent: the server's",
            json_schema_extra={"exclusiveMinimum": 0, "exclusiveMaximum": 1},
        ),
    ] = None
    max_matches: Annotated[
        int, Field(ge=-1, lt=2**31, description="best entries to return; 0: the server's default, -1: all")
    ] = 0
    mask2d_encoding: Annotated[
        MaskEncoding, Field(description="rle: COCO run lengths; png: 8-bit gray, 255 inside, 0 outside")
    ] = "rle"
    mask3d_encoding: Annotated[
        Mask3dEncoding,
        Field(
            description="bits: one bit per Gaussian in row order, most significant bit first; runs: little-endian "
            "uint32 lengths of the alternating runs in row order, outside first; indices: little-endian uint32 row "
            "numbers inside, ascending; ply: the Gaussians themselves, for one text"
        ),
    ] = "bits"
    asker: Annotated[
        Pose | None,
        Field(
            description="where who asks stands and looks, for left, right, in front of, behind, nearest: a camera's "
            "pose, OpenCV axes (x right, y down, z forward)"
        ),
    ] = None
    asker_view: Annotated[
        str | None, Field(description="name of one of the scene's own cameras, instead of `asker`")
    ] = None


@dataclass(frozen=True)
class QueryRequest(QueryIn, OfScene):
    """Questions to one scene, or to all ready scenes of the project."""

    scene_id: Annotated[str, Field(description="empty: all ready scenes of the project, without cameras and views")]


@travels(request=False)
class Match(NamedTuple):
    """One name compared with one question."""

    label_id: Annotated[
        int, Field(description="of the dictionary's label; larger than any of them for a name that is only suggested")
    ]
    label: str
    relevancy: Annotated[float, Field(description="0..1")]
    similarity: Annotated[float, Field(description="cosine, -1..1")]
    nearest_negative: Annotated[str, Field(description="the canonical negative that set the relevancy")]
    gaussian_count: Annotated[
        Int64,
        Field(description="that bear it; of a relevant entry where `objects` are picked, those of its objects there"),
    ]
    relevant: Annotated[bool, Field(description="passes the encoder's threshold, or was asked for by name")]
    probability: Annotated[
        float | None, Field(description="calibrated, 0..1, that this entry is wanted; absent without calibration")
    ] = None


@travels(request=False)
class Searched(NamedTuple):
    """What a scene was searched for: a text that it has nothing for may be an object without a name."""

    named_objects: Annotated[
        int | None, Field(description="objects that have a name; absent for a scene that stores no objects")
    ]
    unnamed_objects: Annotated[int, Field(description="objects that have none")]
    unnamed: Annotated[Many[int], Field(description="their ids, the first 100")]
    names: Annotated[
        int | None, Field(description="names that a detector looked for, or that label maps had; absent if unknown")
    ]


_NOTHING_SEARCHED = Searched(None, 0, (), None)


@dataclass(frozen=True)
class Answer(Response):
    """The answer to one text of one scene."""

    scene_id: str
    text: Annotated[str, Field(description="as asked")]
    probability: Annotated[
        float | None,
        Field(
            description="calibrated, 0..1, that the answer shown is right: of not_here, that it is not; else, that "
            "what is shown is what was asked for: how sure its name is, times how sure it is that the words mean that "
            "name; absent without calibration, and where nothing is decided"
        ),
    ]
    label_set: Annotated[
        Many[int],
        Field(
            description="label ids that together answer with probability `coverage` at least; 0 among them: perhaps "
            "nothing here answers"
        ),
    ]
    coverage: Annotated[float | None, Field(description="0..1; absent without calibration: nothing is promised")]
    version: Annotated[str, Field(description="of the scene")]
    gaussians: Annotated[Int64, Field(description="G, the length of the 3D mask")]
    match_count: Annotated[int, Field(description="names in the whole dictionary, only suggested ones included")]
    matches: Annotated[
        Many[Match],
        Field(
            description="entries of the dictionary, up to `max_matches`: the relevant ones, then the others, each by "
            "`probability`, or, where that is absent, by `relevancy` (by `similarity`, if the server is set to score "
            "by that); with a `phrase` the relevant ones in the order of `object_ids`"
        ),
    ]
    masks: Annotated[
        Many[ViewMask],
        Carried("QueryResponse"),
        Field(description="cameras first, then views, each in the order asked"),
    ]
    mask3d: Annotated[
        Base64 | None,
        Carried("QueryResponse"),
        Field(description="in the encoding asked for, base64 in JSON; absent unless asked for"),
    ] = None
    objects: Annotated[
        Many[SceneObject] | None,
        Carried("QueryResponse"),
        Field(
            description="those of `object_ids` that have a name and can be seen, by label in the order of the matches, "
            "the largest first; absent unless asked for"
        ),
    ] = None
    presence: Annotated[
        float | None,
        Field(
            description="calibrated, 0..1, that anything here answers, whatever the outcome: orders answers of "
            "different texts or scenes; absent without calibration, and where the closest is known to be something else"
        ),
    ] = None
    object_ids: Annotated[
        Many[int],
        Field(
            description="ids of the objects that answer, by label in the order of the matches; of a scene that stores "
            "no objects only with the output objects"
        ),
    ] = ()
    searched: Annotated[Searched, Field(description="what an absence was said of")] = _NOTHING_SEARCHED
    relation: Annotated[
        Relation,
        Field(
            description="what the first match is to what was asked: same: its name, an alias or a synonym; kind_of and "
            "part_of: see `relation_subject`; related: by association; absent: nothing here answers; undecided: "
            "nothing is said"
        ),
    ] = "absent"
    relation_subject: Annotated[
        RelationSubject | None,
        Field(
            description="label: the first match is a kind or a part of what was asked (banana for fruit); question: "
            "the other way (chair for armchair); absent for other relations"
        ),
    ] = None
    method: Annotated[
        AnswerMethod,
        Field(
            description="what the probabilities come from: lexicon: the text encoder with a lexicon beside it; "
            "encoder: the text encoder alone; names: neither is calibrated, names alone count"
        ),
    ] = "names"
    phrase: Annotated[
        PhraseAnswer | None,
        Field(
            description="what else the text says beside a name, and which objects that means; absent for a plain name. "
            "Objects and masks are of these objects alone; where it was not decided, of those that may be meant"
        ),
    ] = None
    outcome: Annotated[
        Outcome,
        Field(
            description="here: what was asked for is here; probably_here: it may be, as its name is not sure or only "
            "suggested, or what comes closest to it is here; `probability` says how likely; not_here: it is not; "
            "not_seen: nothing that was seen is it, but photos do not show enough of the place to say that it is not "
            "here; cannot_say: it cannot be said, `sentence` says what would help, and `object_ids` are those that may "
            "be it, the likeliest first"
        ),
    ] = "cannot_say"
    sentence: Annotated[
        str,
        Field(description="the answer for people, the same over every interface; objects are called by their names"),
    ] = ""
    provisional: Annotated[
        Provisional | None, Field(description="what the version is made of, if it is a draft; absent if it is none")
    ] = None
    noun_phrase: Annotated[
        str, Field(description="what the text asks for, without question words, articles and politeness: a name")
    ] = ""

    @property
    def relevant_ids(self) -> tuple[int, ...]:
        """Label ids of the relevant entries, best first; empty when absent."""
        return tuple(match.label_id for match in self.matches if match.relevant)

    @property
    def is_absent(self) -> bool:
        """Whether nothing that was seen is what was asked for."""
        return self.outcome in ("not_here", "not_seen")

    @property
    def shows_something(self) -> bool:
        """Whether there are objects, or entries of the dictionary, to be shown."""
        return bool(self.object_ids or self.relevant_ids)


@dataclass(frozen=True)
class SkippedScene(Response):
    """A scene that a question to all scenes did not ask, and why."""

    scene_id: str
    reason: Annotated[
        str, Field(description="OVER_LIMIT: so many newer ones were asked; else the stable reason of its error")
    ]
    detail: Annotated[str, Field(description="one sentence for people")]


@travels(request=False, proto="QueryResponse")
class QueryOut(NamedTuple):
    """One answer a text; over all scenes, one a scene and text."""

    answers: Many[Answer]
    skipped: Annotated[
        Many[SkippedScene],
        Field(description="over all scenes: those that were not asked, newest first, the first 1,000 of them"),
    ] = ()
    skipped_count: Annotated[int, Field(description="how many scenes were not asked")] = 0
