// The page of the scene service: list, upload, watch, ask. It uses the public REST interface and nothing else.
// Its addresses are relative, so that a proxy may show it under any path that ends with a slash.

const byId = (id) => document.getElementById(id);
const POLL_MS = 1000;
const PICTURES = { rgb: "the view", overlay: "the answer", relevancy: "relevancy, blue 0 to red 1" };

let current = null; // id of the scene on show
let shown = ""; // id and state of the scene as last drawn
let listed = ""; // the scenes as last drawn
let asked = 0; // counts questions: a late answer to an older one is dropped

/** A new element with text (never markup: names come from users) and attributes. */
function element(tag, text = "", attributes = {}) {
  const node = document.createElement(tag);
  node.textContent = text;
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  return node;
}

function complain(message) {
  byId("problem").textContent = message;
  byId("problem").hidden = !message;
}

/** What a problem+json says, for people. */
function worded(problem) {
  return [problem.detail, problem.limit && `(limit: ${problem.limit})`, problem.hint].filter(Boolean).join(" ");
}

/** The access key, kept for as long as the tab lives. */
const key = { get: () => sessionStorage.getItem("key") ?? "", set: (value) => sessionStorage.setItem("key", value) };

/** fetch with the key; without a valid one, the page asks for it. */
async function knock(path, options = {}) {
  const response = await fetch(path, { ...options, headers: key.get() ? { Authorization: `Bearer ${key.get()}` } : {} });
  byId("login").hidden = response.status !== 401;
  return response;
}

async function call(path, options) {
  const response = await knock(path, options);
  const body = response.status === 204 ? null : await response.json();
  if (!response.ok) throw new Error(worded(body));
  return body;
}

/** The address of a file that needs the key: an <img> or a link of its own could not send it. */
async function fetched(path) {
  const response = await knock(path);
  if (!response.ok) throw new Error(worded(await response.json()));
  return URL.createObjectURL(await response.blob());
}

/** A link that downloads with the key. */
function download(label, path, name) {
  const link = element("a", label, { href: "#" });
  link.addEventListener("click", (event) => {
    event.preventDefault();
    attempt(async () => {
      const address = await fetched(path);
      element("a", "", { href: address, download: name }).click();
      setTimeout(() => URL.revokeObjectURL(address), 60_000);
    });
  });
  return link;
}

/** Run an action of the user; what goes wrong is shown. */
async function attempt(action) {
  complain("");
  try {
    await action();
  } catch (error) {
    complain(error.message);
  }
}

async function listScenes() {
  const { scenes } = await call("v1/scenes?page_size=100");
  const key = JSON.stringify([current, scenes]);
  if (key === listed) return; // drawing anew would take the keyboard's focus away
  listed = key;
  byId("no-scenes").hidden = scenes.length > 0;
  byId("scenes").replaceChildren(
    ...scenes.map((scene) => {
      const button = element("button", `${scene.name || scene.id} `, { type: "button" });
      button.append(element("small", scene.state === "READY" ? `${scene.gaussians} Gaussians` : scene.state.toLowerCase()));
      button.setAttribute("aria-current", String(scene.id === current));
      button.addEventListener("click", () => attempt(() => open(scene.id)));
      const item = element("li");
      item.append(button);
      return item;
    }),
  );
}

async function open(sceneId) {
  current = sceneId;
  shown = "";
  asked += 1;
  byId("pictures").replaceChildren();
  byId("verdict").textContent = byId("downloads").textContent = "";
  byId("matches").hidden = byId("objects").hidden = true;
  await Promise.all([refresh(), listScenes()]);
}

/** Draw the scene on show, if anything about it has changed. */
async function refresh() {
  const sceneId = current;
  const scene = await call(`v1/scenes/${sceneId}`);
  const operation = await call(`v1/operations/${scene.operation_id}`);
  if (sceneId !== current) return;
  byId("scene").hidden = false;
  byId("cancel").hidden = operation.done;
  byId("cancel").onclick = () => attempt(() => call(`v1/operations/${operation.id}:cancel`, { method: "POST" }));
  drawStages(operation);
  const drawn = `${scene.id} ${scene.state} ${scene.version}`;
  if (drawn === shown) return;
  shown = drawn;
  byId("scene-name").textContent = scene.name || scene.id;
  const labels = scene.dictionary.map((entry) => entry.label).join(", ");
  byId("scene-facts").textContent =
    scene.state === "READY" ? `${scene.gaussians} Gaussians; ${scene.cameras.length} views; knows: ${labels}` : "";
  byId("asking").hidden = scene.state !== "READY";
  byId("question").view.replaceChildren(...scene.cameras.map((camera) => element("option", camera.name)));
}

function drawStages(operation) {
  const items = operation.stages.map((stage) => {
    const item = element("li", `${stage.stage}: ${stage.message} (${stage.seconds.toFixed(0)} s)`);
    item.append(element("progress", "", { max: 1, value: stage.fraction }));
    return item;
  });
  if (operation.state === "SUCCEEDED") items.length = 0;
  if (operation.state === "QUEUED") items.push(element("li", "waiting for a worker"));
  if (operation.error) items.push(element("li", `failed at ${operation.error.stage}: ${operation.error.message} ${operation.error.details.hint ?? ""}`));
  byId("stages").replaceChildren(...items);
}

/** Post the form; XMLHttpRequest, as fetch does not tell how much has been sent. */
function upload(form) {
  const files = [...form.files.files];
  const single = files.length === 1 && !files[0].type.startsWith("image/");
  const body = new FormData();
  for (const name of ["name", "labels"]) if (form[name].value) body.append(name, form[name].value);
  body.append("request_id", requestId());
  for (const file of files) body.append(single ? "capture" : "images", file, file.name);
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.responseType = "json";
    request.upload.addEventListener("progress", (event) => {
      byId("sent").hidden = false;
      byId("sent").value = event.lengthComputable ? event.loaded / event.total : 0;
    });
    request.addEventListener("loadend", () => (byId("sent").hidden = true));
    request.addEventListener("error", () => reject(new Error("The connection broke; send it again.")));
    request.addEventListener("load", () =>
      request.status === 202 ? resolve(request.response) : reject(new Error(worded(request.response ?? {}))),
    );
    request.open("POST", "v1/scenes");
    if (key.get()) request.setRequestHeader("Authorization", `Bearer ${key.get()}`);
    request.send(body);
  });
}

/** crypto.randomUUID exists on https and localhost only; a LAN address needs this. */
function requestId() {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

async function ask(form) {
  const number = ++asked;
  const [text, view] = [form.text.value, form.view.value];
  const scene = encodeURIComponent(current);
  const { answers } = await call(`query?${new URLSearchParams({ text, scene: current, outputs: "objects" })}`);
  if (number !== asked) return;
  const [answer] = answers;
  byId("verdict").textContent = [`${answer.verdict}:`, answer.explanation, ...sureness(answer)].join(" ");
  byId("matches").hidden = false;
  byId("matches").tBodies[0].replaceChildren(...answer.matches.map(matchRow));
  byId("objects").hidden = answer.objects.length === 0;
  byId("objects").tBodies[0].replaceChildren(...answer.objects.map(objectRow));
  byId("pictures").replaceChildren(
    ...Object.entries(PICTURES).map(([kind, caption]) => {
      const source = `v1/scenes/${scene}/${kind}.png?${new URLSearchParams({ text, view })}`;
      const figure = element("figure");
      const picture = element("img", "", { alt: `${caption}: ${text}` });
      picture.addEventListener("load", () => URL.revokeObjectURL(picture.src));
      attempt(async () => (picture.src = await fetched(source)));
      figure.append(picture, element("figcaption", caption));
      return figure;
    }),
  );
  byId("downloads").replaceChildren(
    download("the answer as PLY", `v1/scenes/${scene}/mask.ply?${new URLSearchParams({ text })}`, "mask.ply"),
    download("the scene as PLY", `v1/scenes/${scene}/scene.ply`, "scene.ply"),
  );
}

/** What a calibrated answer adds: how likely it is right, and which labels hold the right one with which coverage. */
function sureness(answer) {
  if (answer.probability === null) return [];
  const names = new Map(answer.matches.map((match) => [match.label_id, match.label]));
  const set = answer.label_set.map((id) => (id === 0 ? "nothing here" : (names.get(id) ?? `label ${id}`)));
  const covered = answer.coverage === null ? [] : [`With ${percent(answer.coverage)} coverage it is among: ${set.join(", ")}.`];
  return covered; // the explanation says how likely the verdict is
}

function percent(share) {
  return `${(100 * share).toFixed(0)} %`;
}

function objectRow(thing) {
  const row = element("tr");
  const unit = thing.meters ? "m" : "units";
  const vector = ({ x, y, z }) => [x, y, z].map((value) => value.toFixed(2)).join(", ");
  const cells = [thing.id, vector(thing.box.center.position), `${vector(thing.box.size)} ${unit}`, thing.gaussian_count];
  row.append(element("td", thing.label), ...cells.map((cell) => element("td", cell, { class: "number" })));
  row.append(element("td", thing.best_views[0] ?? ""));
  return row;
}

function matchRow(match) {
  const row = element("tr", "", match.relevant ? { class: "relevant" } : {});
  const likely = match.probability === null ? "" : percent(match.probability);
  const figures = [likely, match.relevancy.toFixed(3), match.similarity.toFixed(3), match.gaussian_count];
  row.append(element("td", match.label), ...figures.map((figure) => element("td", figure, { class: "number" })));
  return row;
}

byId("login").addEventListener("submit", (event) => {
  event.preventDefault();
  key.set(event.target.key.value.trim());
  event.target.reset();
  attempt(listScenes);
});

byId("upload").addEventListener("submit", (event) => {
  event.preventDefault();
  const form = event.target;
  const button = form.querySelector("button");
  button.disabled = true;
  attempt(async () => {
    const operation = await upload(form);
    form.reset();
    await open(operation.scene_id);
  }).finally(() => (button.disabled = false));
});

byId("question").addEventListener("submit", (event) => {
  event.preventDefault();
  attempt(() => ask(event.target));
});

async function watch() {
  try {
    await listScenes();
    if (current) await refresh();
  } catch {
    // The server may be restarting; the next round tells.
  }
  setTimeout(watch, POLL_MS);
}

watch();
