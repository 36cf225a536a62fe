"""What at least two kinds of job share, one module for each subject.

- lengths: `tracers` (lists, readings, starts), `lengths` (noise, stops, scales), `environment` (air), `mirror`,
  `length_effects`
- trackers: `tracker_effects`; images: `images`; parts: `part` (sizes at 20 degC), `features`
- every adjustment: `noise` (estimated, structured), `statistics`, `diagnosed`, `uncontrolled`,
  `joint_covariance`
- files: `lists` (names matched), `weather` (its unit), `rounding`; `figures` (names that `require:` may use)
"""
