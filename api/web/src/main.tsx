import "./styles/base.css";
import "./styles/scenes.css";
import "./styles/scene.css";
import "./ask/ask.css";
import "./serverView/serverView.css";
import "./look/look.css";
import "./styles/change.css";
import "./styles/job.css";
import "./take/take.css";
import "./styles/photos.css";
import "./styles/server.css";

import { render } from "preact";

import { App } from "./app/App";

const root = document.getElementById("page");
if (root) render(<App />, root);
