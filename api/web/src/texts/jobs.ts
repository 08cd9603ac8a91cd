import { plural } from "./figures";

/** Jobs: how a scene is made, and how a finished one is made better. */
export const jobsTexts = {
  job: {
    title: "Progress",
    queued: (ahead: number, time: string) =>
      `Waiting for a worker.${ahead > 0 ? ` ${plural(ahead, "job is", "jobs are")} ahead${time && `, about ${time}`}.` : ""}`,
    cancel: "Cancel the job",
    retry: "Try again",
    retryUnchanged: "Try again with the same photos",
    leaveOut: (photos: readonly string[]) =>
      `Leave out ${photos.length === 1 ? (photos[0] ?? "") : plural(photos.length, "photo", "photos")} and go on`,
    otherPhotos: "Choose other photos",
    failed: (stage: string) => `Failed in the stage “${stage}”.`,
    cancelled: "The job was cancelled.",
    stages: {
      capture: "Photos and cameras",
      perception: "Recognition",
      training: "Training",
      export: "Saving",
      asking: "Asking a model",
      suggesting: "Suggesting names",
    } as Record<string, string>,
    left: (time: string) => `about ${time} left in this stage`,
    spent: (time: string) => `${time} so far`,
    took: (time: string) => `took ${time}`,
    done: "done",
    seconds: (count: number) => `${count} s`,
    minutes: (count: number) => `${count} min`,
  },
  draft: {
    title: "Provisional.",
    of: {
      points: "Made of points, with what the first photos show.",
      training: "Made of a training under way.",
    },
    goesOn: "You can ask, click and name: names stay when the scene is done.",
    ended: "The job ended before the scene was done; this is what there is.",
  },
  jobWatching: {
    left: (time: string) => `About ${time} left in all.`,
    noWorker:
      "No worker is running on the server, so nothing happens. The job begins, or goes on, when one is started.",
    silent: "The worker of this job has stopped answering. Another one will go on where it was.",
    attempt: (number: number, why: string) => `Attempt ${number}: ${why}`,
    againAfter: {
      cancelled: "the job was cancelled, and begins anew because it was tried again.",
      failed: "the job had failed, and begins anew because it was tried again.",
      worker_stopped: "its worker was told to stop; the job goes on where it was.",
      worker_died: "its worker stopped without warning; the job goes on where it was.",
      trainer_died: "the program that trains it stopped without warning; the job goes on where it was.",
    },
    pictureAlt: "The scene as it is trained so far",
    steps: (count: number, time: string) => `${plural(count, "step", "steps")}, ${time}`,
    camerasAlt: (placed: number, images: number) =>
      `Drawing of the cameras of ${placed} of ${images} photos, and points`,
    placed: (placed: number, images: number) => `${placed} of ${images} photos placed`,
    turnLeft: "Turn left",
    turnRight: "Turn right",
    finish: "Stop early and keep it",
    finishQuestion: "Stop the training now and make the scene of what is there?",
    finishYes: "Stop and keep",
    finishNo: "Train on",
    finishing: "The training is ending; the scene is made of what is there.",
  },
  order: {
    states: {
      SUCCEEDED: "Done.",
      FAILED: "It failed.",
      CANCELLED: "It was cancelled.",
    },
  },
  lookAgain: {
    title: "Look for more names",
    help: "The server looks at the scene again for what you name, and names the objects that it finds. It takes a while.",
    names: "Names, separated by commas",
    submit: "Look again",
    running: "Looking.",
    named: (names: string) => `Named: ${names}.`,
    suggested: (names: string) => `Suggested, not sure enough for a name: ${names}.`,
    nothing: "Nothing here is that.",
  },
  observe: {
    title: "Compare with today",
    help: "Photos of the place as it is now, two to ten from several sides, are compared with the scene. What they show to be gone, moved, new or changed is kept with it, and can be asked and undone.",
    choose: "Photos of today",
    submit: "Compare",
    kept: (photos: number) => `${photos} photos are compared.`,
    day: (when: string, photos: number) => `${when} · ${photos} photos`,
    leftOut: (why: string) => `Left out: ${why}`,
    before: "In the scene",
    after: "In the photo",
    show: "Show in the scene",
    undo: "Undo this comparison",
    undone: "The comparison is undone.",
  },
  nextPhotos: {
    title: "Where to stand next",
    none: "No place to stand at would add much.",
    fly: "Look from there",
  },
};
