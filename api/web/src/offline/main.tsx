import "../styles/base.css";
import "../styles/scene.css";
import "../ask/ask.css";
import "./offline.css";

import { render } from "preact";

import type { SceneData } from "./data";
import { OfflinePage } from "./OfflinePage";

const root = document.getElementById("page");
const scene = document.getElementById("scene")?.textContent;
if (root && scene) {
  const data = JSON.parse(scene) as SceneData;
  if (data.name) document.title = data.name;
  render(<OfflinePage data={data} />, root);
}
