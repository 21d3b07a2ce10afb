"""Rigid interlinked rings in a periodic cell: where a ring mesh locks under each load direction."""
