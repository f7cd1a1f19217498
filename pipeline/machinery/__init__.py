"""Infrastructure shared by the stages: processes, folders that become complete, the console.

It knows no stage.
"""
