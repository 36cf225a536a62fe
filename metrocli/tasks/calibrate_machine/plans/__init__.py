"""What planned measurements of each method will determine, and how they are proposed.

`settings` (what is asked for) -> one module a method: `path_search` (on the fly), `stops` (standstill, laser lines),
`stations` (lengths), `poses` (rotary axes) -> `planned` (what it will determine); `pose_program` is its NC program.
"""
