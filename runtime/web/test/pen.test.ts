import { describe, expect, it } from "vitest";
import type { Mark } from "../src/drawings";
import { Pen, type Tool } from "../src/ui/pen";

/** A pen with a tool, and what it has drawn. */
function pen(tool: Tool): { pen: Pen; marks: Mark[]; drafts: (Mark | undefined)[] } {
  const [marks, drafts]: [Mark[], (Mark | undefined)[]] = [[], []];
  const made = new Pen({ onBegin: () => undefined, onDraft: (mark) => drafts.push(mark), onMark: (mark) => marks.push(mark) });
  return { pen: Object.assign(made, { tool, colour: "#123456", size: 4, longer: 100 }), marks, drafts };
}

const click = (own: Pen, x: number, y: number, t = 3): void => {
  own.press({ x, y }, 0.5, t);
  own.lift({ x, y }, 2);
};

describe("the pen", () => {
  it("draws a line, with the pressure of the pen", () => {
    const { pen: own, marks } = pen("brush");
    own.press({ x: 1, y: 2 }, 0.25, 7);
    own.go({ x: 5.123, y: 6 }, 0.75);
    own.lift({ x: 5.123, y: 6 }, 2);
    expect(marks).toEqual([{ kind: "stroke", t: 7, ink: "#123456", size: 4, path: [[1, 2, 0.25], [5.12, 6, 0.75]] }]);
    expect(own.isBusy).toBe(false);
  });

  it("closes a polygon that is clicked at its first corner, or twice at its last", () => {
    for (const end of [[10.5, 10], [20, 31]] as const) {
      const { pen: own, marks } = pen("polygon");
      for (const [x, y] of [[10, 10], [30, 10], [20, 30]] as const) click(own, x, y);
      expect(marks).toEqual([]);
      click(own, end[0], end[1]);
      expect(marks).toEqual([{ kind: "area", t: 3, ink: "#123456", corners: [{ x: 10, y: 10 }, { x: 30, y: 10 }, { x: 20, y: 30 }] }]);
    }
  });

  it("takes a drag for the outline of a polygon", () => {
    const { pen: own, marks } = pen("polygon");
    own.press({ x: 0, y: 0 }, 0.5, 0);
    for (const [x, y] of [[10, 0], [10, 10]] as const) own.go({ x, y }, 0.5);
    own.lift({ x: 10, y: 10 }, 2);
    expect(marks.map((mark) => mark.kind === "area" && mark.corners.length)).toEqual([3]);
  });

  it("begins anew in another frame, and gives up what it is told to", () => {
    const { pen: own, marks, drafts } = pen("polygon");
    click(own, 10, 10, 3);
    click(own, 30, 10, 4);
    expect(drafts.includes(undefined)).toBe(true);
    own.cancel();
    expect([own.isBusy, marks.length]).toEqual([false, 0]);
  });

  it("erases, and draws nothing where a box or a text has none", () => {
    const eraser = pen("eraser");
    click(eraser.pen, 1, 1);
    expect(eraser.marks[0]).toMatchObject({ kind: "stroke", ink: null });
    for (const tool of ["box", "text", "picture"] as const) {
      const { pen: own, marks } = pen(tool);
      click(own, 1, 1);
      expect(marks).toEqual([]);
    }
  });

  it("keeps the shape of a picture, dragged from any corner", () => {
    const { pen: own, marks } = pen("picture");
    own.picture = { width: 40, height: 20, source: "" };
    own.press({ x: 50, y: 50 }, 0.5, 0);
    own.go({ x: 30, y: 48 }, 0.5);
    own.lift({ x: 30, y: 48 }, 2);
    expect(marks[0]).toMatchObject({ size: { width: 20, height: 10 }, at: { x: 40, y: 45 } });
  });
});
