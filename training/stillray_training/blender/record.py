"""Names of files by which a scene's renders say how far they are."""

#: Settings of a scene, written when all of it is rendered.
RECORD = "rendered.json"
#: Stands in place of renders that were made a sequence and deleted.
TAKEN = "taken"
