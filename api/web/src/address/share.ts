import { shareKeyIn } from "./addresses";

/** The key of the link by which this page was opened. It is used instead of the browser's own, and not remembered. */
export const shareKey = shareKeyIn(location.hash);

/** Whether this page shows the one scene of a link: then nothing is changed from here. */
export const isShared = shareKey !== "";
