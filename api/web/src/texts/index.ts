import { changeTexts } from "./change";
import { cleanUpTexts } from "./cleanUp";
import { generalTexts } from "./general";
import { jobsTexts } from "./jobs";
import { lookTexts } from "./look";
import { captionerTexts } from "./captioner";
import { sceneTexts } from "./scene";
import { serverTexts } from "./server";
import { takeTexts } from "./take";
import { objectsTexts } from "./objects";
import { uploadTexts } from "./upload";

/** Every English text of the page. What the server says of an error or an answer is shown as it says it. */
export const texts = {
  ...changeTexts,
  ...cleanUpTexts,
  ...generalTexts,
  ...jobsTexts,
  ...lookTexts,
  ...captionerTexts,
  ...sceneTexts,
  ...serverTexts,
  ...takeTexts,
  ...objectsTexts,
  ...uploadTexts,
};
