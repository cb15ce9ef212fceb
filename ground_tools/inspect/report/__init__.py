"""Results of a run as figures, text, an HTML page and pictures.

`summary.describe` computes all figures of a run as one dictionary ready for JSON; most other modules present
it. `terminal` prints the figures as text and tables, `page` writes them with plots as one offline HTML page,
and `plots` draws the SVG for it. `compare` lists the differences between two or more runs. `picture`
implements `ground-tools picture`, which writes a single image. Start reading with `summary.describe`.
"""
