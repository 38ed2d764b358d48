"""Figures of what the robots of a table drive: one for each of them and each group of scenes."""

from experiments import study
from experiments.tables import methods
from jaxnav import preset
from jaxnav.render import figures
from jaxnav.training import member
from jaxnav.world import default_params


def draw(table) -> None:
    """Draw every method of a `Table` after its last budget, with its first good seed, and every scripted robot.

    A figure that is there is drawn again only if its method was played in this call.
    """
    folder = table.options.out / "trajectories"
    study.make_folder(folder)
    for group in methods.GROUPS:
        world, params = preset("quick").world.of_scenes(group).world(), default_params(group)
        for name, method in table.methods.items():
            drawn = _path(folder, name, group).exists() and (name, group) not in table.played
            if not drawn and (episodes := _recorded(table, method, group)):
                figures.trajectories(world, episodes, _path(folder, name, group), params, methods.DRAWN)
        for name, player in methods.SCRIPTED.items():
            asked = [i for i, scene in enumerate(group) if table.options.asked(scene)]
            if asked and not _path(folder, name, group).exists():
                playing = methods.Playing(world, params)
                episodes = [e for i in asked for e in playing.record(player, i, table.options.seed)]
                figures.trajectories(world, episodes, _path(folder, name, group), params, methods.DRAWN)


def _path(folder, name, group):
    return folder / f"{name.lower().replace(',', '').replace(' ', '-')}-{group[0]}.png"


def _recorded(table, method, group):
    """Episodes of a method in those scenes of a group for which its trainings are at hand."""
    config, episodes, programs = methods.configuration(method, group, table.options.converged), [], None
    for index, scene in enumerate(group):
        folder = table.runs.of(method, scene, list(table.options.blocks_of(method))[-1])
        if not (folder / "training.json").exists():
            continue
        broken = table.runs.training(folder, config)["broken"]
        if None in broken:
            programs = programs or methods.Programs(config, table.options.seeds, method.told)
            actor = member(programs.policies(folder), broken.index(None))
            player = programs.player(actor, method.voice)
            episodes += programs.playing.record(player, index, table.options.seed)
    return episodes
