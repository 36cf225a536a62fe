"""Results and projects as self-contained HTML pages.

`result_page` and `project_page` put together parts: `findings` (a diagnosis), `pictures` (figures), and the
elements of `html`, which escape everything; `pdf` has the look, and prints.
"""
