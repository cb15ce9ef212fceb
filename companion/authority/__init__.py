"""Who flies: the table of states, what moves it, and the plan of what is flown or guarded."""
