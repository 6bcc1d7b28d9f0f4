"""Results for people: tables, drawings, clips and the page of a run."""
