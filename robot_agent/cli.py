"""The robot-agent command. Plain argparse: nothing to install on a Raspberry Pi."""

from __future__ import annotations

import logging
import sys
from argparse import Namespace
from collections.abc import Sequence

from robot_agent.agent import Agent, AgentSettings
from robot_agent.announce import announced
from robot_agent.ending import EXIT_DONE, exit_code, interrupt, on_end_signals
from robot_agent.errors import AgentError
from robot_agent.options import agent_parser, rig_options, safety_settings
from robot_agent.rig import build_rig


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the agent. Returns the exit code: 0 done, 1 failed, 2 wrong usage."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments and arguments[0] == "doctor":
        from robot_agent.doctor.cli import main as doctor

        return doctor(arguments[1:])
    options = agent_parser().parse_args(arguments)
    logging.basicConfig(
        level=logging.WARNING if options.quiet else logging.INFO,
        format="%(asctime)s robot-agent: %(message)s",
        datefmt="%H:%M:%S",
    )
    on_end_signals(interrupt)
    try:
        _serve(options)
    except KeyboardInterrupt:
        return EXIT_DONE  # before anything could move
    except AgentError as error:
        print(f"robot-agent: {error}", file=sys.stderr)
        return exit_code(error)
    return EXIT_DONE


def _serve(options: Namespace) -> None:
    rig = build_rig(rig_options(options))
    settings = AgentSettings(
        host=options.listen,
        port=options.port,
        allow=tuple(options.allow),
        rhythm=options.rhythm,
        rows=options.rows,
        speed_scale=options.speed_scale,
        safety=safety_settings(options),
    )
    try:
        agent = Agent(
            rig.camera,
            rig.robot,
            settings,
            pan_tilt=rig.pan_tilt,
            scenario=rig.scenario,
            clock=rig.clock,
            stepped=rig.stepped,
        )
        names = {"robot": rig.robot.kind, "camera": type(rig.camera).__name__}
        announcement = announced(options.listen, options.port, wanted=options.announce, **names)
    except AgentError:
        rig.close()
        raise

    on_end_signals(agent.stop)
    logging.getLogger(__name__).info(
        "serving robot %s on %s, ports %d to %d (%s rhythm)",
        options.robot,
        options.listen,
        options.port,
        options.port + 3,
        options.rhythm,
    )
    try:
        agent.run()
    finally:
        if announcement is not None:
            announcement.close()
