"""Figures of uncertainty budgets: contributors, trials, and the decision."""
