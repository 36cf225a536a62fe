"""Files that are read and written: tables, images, meshes and results, each whole or not at all.

- `csv`: a table. `file_bytes` reads the bytes with their hash; `csv_header`, then `csv_plain` (the quick way) or
  `csv_text` find the cells, `csv_columns` the columns
- `images`: grey values, after `image_headers`; `own_files`: meshes, and files of users that are kept
- `hdf5`: a result. `hdf5_writing` in memory, then `seal`, then `file_bytes`, which renames a finished file; back
  by `hdf5_reading`
"""
