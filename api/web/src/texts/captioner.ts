import { plural } from "./figures";

/** The server's captioner. */
export const captionerTexts = {
  captioner: {
    title: "Names from a model",
    asks: (host: string, model: string) =>
      `${model} at ${host} can suggest names for objects without one. Pictures of these objects, cut from the photos, ` +
      "their sizes and the names beside them would go to that host, of each new scene and whenever somebody asks. " +
      "Nothing is sent before the project agrees.",
    agreed: (host: string, model: string) =>
      `The project agreed: pictures of objects without a name go to ${host}, of each new scene and when ${model} is asked.`,
    adminAgrees: "An admin of the project can agree.",
    agree: (host: string) => `Agree to send pictures to ${host}`,
    takeBack: "Take the agreement back",
    ask: (model: string) => `Ask ${model}`,
    running: "Asking.",
    told: (suggested: number, shown: number, refused: number) =>
      `${plural(suggested, "name", "names")} suggested for ${plural(shown, "object", "objects")}.` +
      (refused ? ` ${plural(refused, "name was", "names were")} refused.` : ""),
  },
};
