"""Jobs and projects: from the text of a job to its result file, and what is up to date."""

PROJECT_FILE = "metrocli.yaml"
"""File that makes a folder a project"""
DIAGNOSIS = ".diagnosis.json"
"""Ending of the diagnosis of a job, beside the result of that job"""
