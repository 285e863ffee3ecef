"""Each command of ``fpk`` under its name, for pages that show a group of commands."""

import click

from cases.command.app import app

CONTEXT = click.Context(app)
globals().update({name: app.get_command(CONTEXT, name) for name in app.list_commands(CONTEXT)})
