"""Settings of the perception package: which models look at the images, and how sure they must be."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import Field

from fastsplat.service.common.setting_groups import Options, SettingGroup


class PerceptionOptions(Options):
    """When detections, tags and masks count."""

    tagger_threshold: float = Field(0.68, ge=0, le=1)
    """A view shows a tag from this probability on, where the tagger brings no thresholds of its own. RAM's default."""
    tagger_texts: int = Field(100, ge=1)
    """Tags that become texts, at most; those in most views first."""
    threads: int = Field(0, ge=0)
    """Threads of one model run; 0 lets onnxruntime take all cores."""
    closer_look: bool = True
    """The closed-set detector also looks at the image's four corners enlarged: five runs instead of one, and small
    objects are detected in twice as many views."""
    tags: tuple[str, ...] = ()
    """What an open-set detector looks for when the user names nothing, in place of the built-in list
    (`fastsplat.service.perception.class_names.TAGS`) or of detected classes, see `tagger`."""
    score_threshold: float = Field(0.5, ge=0, le=1)
    """A class is believed to be in the scene when it scores this much in `min_view_share` of the views."""
    score_floor: float = Field(0.3, ge=0, le=1)
    """Detections of a class that is believed to be in the scene count from this score."""
    min_view_share: float = Field(0.1, ge=0, le=1)
    """See `score_threshold`. Classes that the user named need one view only."""
    min_views: int = Field(2, ge=1)
    """As `min_view_share`, in views; never more than the capture has."""
    min_pixels: int = Field(64, ge=1)
    """Smaller masks are dropped, and so are classes that hold fewer pixels in the view where they hold most."""
    rival_iou: float = Field(0.7, gt=0, le=1)
    """Boxes or masks of two classes that overlap more are rivals for one object: the likelier class keeps it."""
    proposal_quality: float = Field(0.8, ge=0, le=1)
    """Masks without a name count from this predicted intersection over union; see `mask_proposals`."""
    proposal_stability: float = Field(0.88, ge=0, le=1)
    """Masks without a name count from this stability score."""
    reader: str = "ppocr_v6_small"
    """Reads what is written on objects. Empty, or where it was never fetched: only printed codes are read."""
    proposal_points: int = Field(24, ge=0)
    """Prompts in each of these views where no box and no mask explains the pixels, at most."""


class PerceptionSettings(PerceptionOptions, SettingGroup, section="perception"):
    """Which models look at the images, and how sure they must be.

    A model is named as the manifest names it ("picodet_416"), or as "adapter:folder" for a folder of the model
    directory that no manifest lists ("yolo_world:my_folder"). One that is set goes before that of
    `fastsplat models use`.
    """

    text_encoder: str = "minilm_l6_int8"
    """Embeds the dictionary and the questions."""
    lexicon: str = "wordnet"
    """Stands beside the text encoder in judging what a question and a name have to do with each other. Empty, or where
    it was never fetched: the encoder judges alone; answers say so in `method`, and the server's status names it."""
    closed_set_detector: str = "picodet_416"
    """Detects objects of a fixed list of classes."""
    open_set_detector: str = ""
    """Detects objects by name. Empty: the closed-set detector alone looks at the images."""
    prompt_encoder: str = ""
    """Text encoder for an open-set detector that is prompted by embeddings (YOLO-World); must share its space."""
    segmenter: str = "mobile_sam"
    """Turns boxes into masks."""
    tagger: str = ""
    """Proposes what an open-set detector looks for when the user names nothing: the tags that the views agree on
    (`min_view_share`, `min_views`). Empty, or where it proposes nothing: the
    classes that the closed-set detector saw for a Grounding DINO, which takes few words a look, else `tags`. See
    `fastsplat.service.perception.tagging` for the files that it needs."""
    image_text: str = ""
    """Embeds pictures of the objects of new scenes: a model of pictures and texts. Empty: none does."""
    people_words: tuple[str, ...] = ("person",)
    """What detectors are asked for where a scene's makers promise that no people are stored (`privacy`)."""
    mover_words: tuple[str, ...] = ("person", "cat", "dog")
    """What detectors are asked for where what moves is to be left out (`movers`)."""
    open_score_threshold: float | None = Field(None, ge=0, le=1)
    """As `score_threshold`, for the open-set detector. Empty: as its public examples have it, 0.3 of a Grounding DINO,
    0.1 of an OWL-ViT or OWLv2, 0.15 of a YOLO-World."""
    max_views: int = Field(0, ge=0)
    """Views that perception looks at, evenly spread; the rest stay undetected. 0: all."""
    proposal_views: int = Field(16, ge=0)
    """Views whose masks without names are looked for, evenly spread; 0: all. A table needs ten, a large place more."""

    def with_models(self, names: Mapping[str, str]) -> PerceptionSettings:
        """These settings with chosen models by role, except where a model is set."""
        chosen = {role: name for role, name in names.items() if role not in self.model_fields_set}
        return self.model_copy(update=chosen)
