import { expect, test } from "vitest";

import { EventReader } from "./serverEvents";

const STREAM =
  ': a comment\n\nid: 7\nevent: operation\ndata: {"a":\ndata: 1}\n\nid: 8\ndata:two\n\nid: 9\ndata: cut off';

test.each([1, 2, 5, 1000])("events are whole however the stream is cut: pieces of %d", (size) => {
  const reader = new EventReader();
  const events = [];
  for (let at = 0; at < STREAM.length; at += size) events.push(...reader.read(STREAM.slice(at, at + size)));
  expect(events).toEqual([
    { id: "7", data: '{"a":\n1}', kind: "operation" },
    { id: "8", data: "two", kind: "message" },
  ]);
});
