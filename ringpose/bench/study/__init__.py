"""study.yaml -> rows of results, tables and a page."""
