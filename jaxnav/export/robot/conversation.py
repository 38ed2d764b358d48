"""What the robot makes of the words of people, and what it says: by the rules that the contract gives under "dialogue".

Written for Python 3.6.
"""

import numpy as np
from dialogue_rules import is_reply, is_unsure, reaction
from scans import Unusable, finite

_UNHEARD = 4  # messages and one more are kept until they can be heard


class Conversation:
    """The robot's side of all dialogues. contract: of a bundle; policy: its `Policy`, which understands sentences."""

    def __init__(self, contract, policy):
        self._contract, self._policy, self._rules = contract, policy, contract["dialogue"]
        self._unheard, self._turn, self._careful = [], 0, 0

    def forget(self):
        """Drop what was said and not heard yet."""
        self._unheard = []

    def calm_down(self):
        """Go at full speed again."""
        self._careful = 0

    def keep(self, message):
        """Keep a message until `listen`. Unusable: it is neither a vector nor a name that the policy knows."""
        message = self._checked(message)
        if message is not None:
            self._unheard = self._unheard[-_UNHEARD:] + [message]

    def listen(self, people, periods):
        """Hear what was kept. Returns the sentence that answers it, "" for none. periods: since the last call."""
        self._careful = max(self._careful - periods, 0)
        said = ""
        while self._unheard:
            said = self._hear(people, *self._unheard.pop(0)) or said
        return said

    def ask(self, people, request):
        """Put a request to the nearest person who may be asked. Returns its sentence."""
        people.ask(request)
        return self._sentence("request", self._contract["requests"][request]["name"])

    def limit(self, people, v, w):
        """(v, w, reason): the twist that the rules leave of v, w, and why it is another one."""
        if people.are_stood_for():
            return 0.0, 0.0, "stands: it promised somebody to stop"
        slow = self._rules["careful_speed"] * self._contract["control"]["max_v"]
        if self._careful and v > slow:
            return slow, w, "goes slowly: it did not understand"
        return v, w, ""

    def _checked(self, message):
        """None, or (vector or None, name or None)."""
        if message is None:
            return None
        if isinstance(message, str) and message == "unknown":
            return None, message
        if not self._contract["hearing"]:
            raise Unusable("message is given, but this policy was trained deaf: give None")
        language = self._contract["language"]
        if language is None:
            names = self._contract["messages"][1:] + self._contract["replies"][1:]
            if not isinstance(message, str) or message not in names:
                raise Unusable("message %.40r is unknown: give one of %s" % (message, ", ".join(names)))
            return None, message
        words = finite(message, (language["dimensions"],), 10.0)
        if words is None:
            raise Unusable(
                "message is no vector of %d finite numbers: give what Phrasebook().look_up(text) returns, None for "
                'silence, or "unknown"' % language["dimensions"]
            )
        return (words.astype(np.float32), None) if words.any() else None

    def _hear(self, people, words, name):
        """Take in what somebody says. Returns what the robot says to that."""
        message, reply, unsure = self._understand(words) if name is None else self._meaning(name)
        asked = people.who_owes_a_reply()
        react = reaction(message, reply, unsure, asked is not None)
        if react == "reply":
            asked.answer(reply)
            return self._sentence("reply", self._contract["replies"][reply])
        if react == "repeat":
            self._careful = self._rules["careful_periods"]
            return self._sentence("repeat")
        if react == "obey":
            people.speaker().speak(message, words)
            return self._sentence("acknowledge", self._contract["messages"][message])
        if words is not None:  # else it is an answer to nothing
            people.speaker().chat(words)
        return ""

    def _understand(self, words):
        """(message, reply, whether it is unsure) of a vector."""
        heard, answer = self._policy.understand(words)
        meanings = np.append(1.0 - heard.sum(), heard)
        second, first = np.sort(meanings)[-2:]
        reply = int(answer.argmax())
        if not is_reply(answer[reply], self._rules):
            reply = 0
        return int(meanings.argmax()), reply, is_unsure(first - second, self._rules)

    def _meaning(self, name):
        """The same of the name of a message or of a reply."""
        if name == "unknown":
            return 0, 0, True
        if name in self._contract["replies"]:
            return 0, self._contract["replies"].index(name), False
        return self._contract["messages"].index(name), 0, False

    def _sentence(self, *path):
        """One of the contract's sentences, in turns."""
        choices = self._contract["sentences"]
        for name in path:
            choices = choices[name]
        self._turn += 1
        return choices[self._turn % len(choices)]
