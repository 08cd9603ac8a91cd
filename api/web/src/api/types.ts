import type { components } from "./schema";

type Schemas = components["schemas"];

export type Answer = Schemas["Answer"];
export type Edit = Schemas["Edit"];
export type Match = Schemas["Match"];
export type Operation = Schemas["Operation"];
export type PhotoList = Schemas["PhotoList"];
export type PhotoVerdict = Schemas["PhotoVerdict"];
export type PickedThing = Schemas["PickedThing"];
export type PosedCamera = Schemas["PosedCamera"];
export type Problem = Schemas["Problem"];
export type QueryOut = Schemas["QueryOut"];
export type Scene = Schemas["Scene"];
export type SceneList = Schemas["SceneList"];
export type SceneObject = Schemas["SceneObject"];
export type SceneSummary = Schemas["SceneSummary"];
export type SceneThing = Schemas["SceneThing"];
export type SceneVersion = Schemas["SceneVersion"];
export type Segmentation = Schemas["Segmentation"];
export type StageProgress = Schemas["StageProgress"];
export type ThingList = Schemas["ThingList"];
export type Vector3 = Schemas["Vector3"];
export type VersionList = Schemas["VersionList"];
