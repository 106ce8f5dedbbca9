"""The report on a study or a comparison: one HTML file that needs nothing else.

`contents` reads the folder; `tables` and `setting` put numbers into words and cells;
`figures` draws what runs show together, `scene` the pass in space; `embed` turns figures
into parts of the page, and `page` puts it together.
"""
