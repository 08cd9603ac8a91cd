/** What stands on every page, sign-in, and what went wrong. */
export const generalTexts = {
  product: "FAST-Splat",
  skip: "Skip to the content",
  close: "Close",
  cancel: "Cancel",
  loading: "Loading",
  tryAgain: "Try again",
  limit: (limit: string) => `Limit: ${limit}.`,
  nav: { label: "Main", scenes: "Scenes", newScene: "New scene", api: "API", signOut: "Sign out" },
  unknownPage: { title: "Page not found", text: "This address leads nowhere.", back: "To the scenes" },
  errors: {
    unreadable: "The server sent an answer that cannot be read.",
    status: (status: number) => `The server answered with status ${status}.`,
    offline: "The server cannot be reached.",
    offlineNow: "The server cannot be reached. This page tries again by itself.",
    failed: "Something went wrong on this page.",
  },
  signIn: {
    title: "Sign in",
    missing: "This server needs an access key.",
    refused: "The server does not know this key, or it has expired or been revoked.",
    key: "Access key",
    where: "The first start of the server leaves one in the file “key” of its data folder.",
    remember: "This browser remembers it until you sign out.",
    submit: "Sign in",
  },
};
