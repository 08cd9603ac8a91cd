import type { Vec } from "./vectors";
import { cross, dot } from "./vectors";

/** A symmetric 3×3 matrix by its columns. */
type Matrix = readonly [Vec, Vec, Vec];

/** Σ (each direction's outer product with itself), or with `complement` Σ (identity − that). */
export function outerSum(directions: readonly Vec[], complement = false): Matrix {
  const column = (c: 0 | 1 | 2): Vec => {
    const sum: [number, number, number] = [0, 0, 0];
    for (const direction of directions)
      for (const r of [0, 1, 2] as const) {
        const product = direction[r] * direction[c];
        sum[r] += complement ? (r === c ? 1 : 0) - product : product;
      }
    return sum;
  };
  return [column(0), column(1), column(2)];
}

/** The matrix with `value` added along its diagonal. */
export function damped([a, b, c]: Matrix, value: number): Matrix {
  return [
    [a[0] + value, a[1], a[2]],
    [b[0], b[1] + value, b[2]],
    [c[0], c[1], c[2] + value],
  ];
}

/** The product of the matrix and a vector. */
export function times([a, b, c]: Matrix, v: Vec): Vec {
  return [0, 1, 2].map((r) => (a[r] ?? 0) * v[0] + (b[r] ?? 0) * v[1] + (c[r] ?? 0) * v[2]) as unknown as Vec;
}

/** x with matrix · x = right (Cramer's rule); the matrix must not be singular. */
export function solve([a, b, c]: Matrix, right: Vec): Vec {
  const determinant = dot(a, cross(b, c));
  return [
    dot(right, cross(b, c)) / determinant,
    dot(a, cross(right, c)) / determinant,
    dot(a, cross(b, right)) / determinant,
  ];
}
