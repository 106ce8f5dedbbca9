"""The report on a study or a comparison: one HTML file that needs nothing else.

`contents` reads the folder; `cells` makes tables of the numbers, `setting` of the models;
`figures` draws what the runs of a study show together, `scene` the pass in space; `embed`
makes images of figures, `zoom` interactive copies of them, and `page` puts it together.
"""
