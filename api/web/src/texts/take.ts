import { bytesText, dayText, percent, plural } from "./figures";

/** Taking a scene away, links to it, and the file that needs no server. */
export const takeTexts = {
  take: {
    title: "Take away",
    whole: "The whole scene",
    about: (size: string) => `about ${size}`,
    formats: {
      ply: "PLY, exact",
      spz: "SPZ, compressed",
      spz4: "SPZ, version 4",
      sog: "SOG, smallest",
      html: "One HTML file",
      points: "Labelled points, PLY",
      mesh: "Labelled mesh, GLB",
      mcap: "For Foxglove, MCAP",
      map: "Floor map for robots, ZIP",
    },
    kinds: {
      ply: "PLY",
      spz: "SPZ",
      sog: "SOG",
      points: "points",
      mesh: "mesh",
    },
    alone: (name: string, kind: string) => `Only ${name} as ${kind}`,
    masks: (text: string) => `What answers “${text}”`,
    maskPly: "Its Gaussians as PLY",
    mask3d: "3D mask, a bit each Gaussian",
    mask2d: "Mask in this view as PNG",
    picture: "This view",
    size: "Size in pixels",
    png: "Picture as PNG",
    depth: "Depth as NumPy array",
    normals: "Normals as NumPy array",
    confidence: "Confidence as NumPy array",
    cameras: "Cameras",
    transforms: "nerfstudio transforms.json",
    colmap: "COLMAP model",
    camerasWithPoints: "Both, with points, ZIP",
    camerasJson: "JSON",
    running: (label: string, bytes: number, of: number) =>
      `${label}: ${of > 0 ? percent(bytes / of) : bytesText(bytes)}`,
    share: "Link to look at it",
    shareHelp:
      "Whoever has the link sees this scene with its versions, and nothing else; they change nothing. It ends by itself, or when you revoke it.",
    noLink:
      "This server asks nobody for a key, so a link could not show this scene alone: none is made. To send the scene, save it as one HTML file, which needs no server.",
    adminsLink: "Admins of the project make links. You can save the scene as one HTML file, which needs no server.",
    saveHtml: "Save as one HTML file",
    forWhom: "For whom",
    link: "link",
    validFor: "Valid for",
    days: (count: number) => plural(count, "day", "days"),
    makeLink: "Make a link",
    newLink: "The link; it is shown this once",
    revoke: "Revoke",
    revokeLink: (name: string) => `Revoke the link for ${name}`,
    state: (state: string, expires: string | null) =>
      state === "VALID" && expires ? `until ${dayText(expires)}` : state.toLowerCase(),
    ended: "This link has ended",
    endedText: "It has expired or was revoked. Ask the person who sent it for another one.",
  },
  offline: {
    about: "This file holds the scene. It needs no server and asks nobody for anything.",
    noWebGL: "This browser has no WebGL 2, so the scene cannot be shown in 3D. Its names are listed all the same.",
    unknown: "Not answerable offline",
    unknownText: (text: string) =>
      `This file knows the scene’s own names only, and “${text}” is none of them. The server may find it all the same.`,
    leftOut: (count: number) => `${plural(count, "more name is", "more names are")} known to the server only.`,
  },
};
