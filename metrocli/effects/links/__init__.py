"""Links of effects; each module holds one family, by what it acts on.

- quantities: `lengths`, `angles`, `images` (with `lens_shape`), `points`, `shifts` (points on their way to a camera)
- machines: `motions` (linear axes), `turning` (rotary axes); networks: `stations`
- `own`: expressions of the user
"""
