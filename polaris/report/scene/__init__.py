"""What a run's pictures show, computed once as plain data: the printed figures and the page draw the same."""
