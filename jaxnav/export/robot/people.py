"""Who is near the robot, told apart from call to call, and the dialogue with each of them. Written for Python 3.6.

Places are in the frame of the poses. A dialogue opens when a person is near and will soon be nearer, and closes when
the person has gone away; who speaks first in it, what is asked and answered is all that is remembered.
"""

import math

import numpy as np
from dialogue_rules import speaker, stands, walks_into

_ASSOCIATE = 0.6  # m around where a person should be by now, in which it may be found again
_FORGET = 3.0  # s after which a person who is no longer seen is forgotten
_STOP, _REFUSES = 1, 2  # the message, the reply
_MOST = 50  # people who are followed, the nearest
_OLDEST = 1000  # periods: the policy doesn't tell ages of more than ten apart
_WALKING_SPEED = 0.5  # m/s at which a dialogue opens at exactly the contract's distance


class Person:
    """Somebody near the robot. placed, seen: whether they were ever seen, and are now; first: whether they spoke first;
    message: what they asked of the robot; words: the vector of what they said; fleeting: whether that is small talk."""

    def __init__(self, dimensions):
        self.x = self.y = self.vx = self.vy = 0.0
        self.placed = self.seen = False
        self.seen_at = 0.0
        self.met = False
        self.distance, self.grown = math.inf, 0
        self._silence = np.zeros(dimensions, np.float32)
        self.close()

    def close(self):
        """End the dialogue."""
        self.is_open = self.first = self.fleeting = False
        self.message, self.words = 0, self._silence
        self.message_age = self.request = self.request_age = self.reply = self.reply_age = 0

    def speak(self, message, words):
        """They ask the robot for ``message``, in these words: the dialogue is open, and it is they who spoke first."""
        self.close()
        self.met = self.is_open = self.first = True
        self.message, self.words, self.grown = message, self._silence if words is None else words, 0

    def answer(self, reply):
        """They agree to what they were asked for, or refuse."""
        self.reply, self.reply_age = reply, 0

    def chat(self, words):
        """They say something that asks for nothing. What they asked for before still holds."""
        if self.message == 0:
            self.words, self.fleeting = words, True

    @property
    def spoken(self):
        return self.message != 0 or bool(self.words.any())

    @property
    def may_be_asked(self):
        return self.is_open and not self.first and self.request == 0


class People:
    """The people around a robot. contract: of a bundle."""

    def __init__(self, contract):
        self._gate, self._max_v = contract["encounter"], contract["control"]["max_v"]
        self._nearest, self._rules = contract["people"]["nearest"], contract["dialogue"]
        self._clearance = contract["robot"]["radius"] + contract["people"]["radius"] + self._rules["stand_gap"]
        self._dimensions = 0 if contract["language"] is None else contract["language"]["dimensions"]
        self._people, self._now, self._pose = [], 0.0, (0.0, 0.0, 0.0)

    def follow(self, rows, pose, now):
        """Find the people of the last call again, each where it should be by now; those left over are new.

        rows: [n, 4] x, y, velocity x, velocity y in the robot frame; pose: x, y, heading.
        """
        x, y, heading = pose
        cos, sin = math.cos(heading), math.sin(heading)
        rows = rows[np.argsort(np.hypot(rows[:, 0], rows[:, 1]), kind="mergesort")[:_MOST]]
        for person in self._people:
            person.seen = False
            person.x, person.y = person.x + (now - self._now) * person.vx, person.y + (now - self._now) * person.vy
        places = [
            (x + cos * a - sin * b, y + sin * a + cos * b, cos * va - sin * vb, sin * va + cos * vb)
            for a, b, va, vb in rows.tolist()
        ]
        pairs = sorted(
            (math.hypot(place[0] - person.x, place[1] - person.y), i, j)
            for i, place in enumerate(places)
            for j, person in enumerate(self._people)
            if person.placed
        )
        taken, found = set(), {}
        for distance, i, j in pairs:
            if distance <= _ASSOCIATE and i not in found and j not in taken:
                found[i] = self._people[j]
                taken.add(j)
        for i, place in enumerate(places):
            person = found.get(i) or self._somebody_new()
            person.x, person.y, person.vx, person.vy = place
            person.placed = person.seen = True
            person.seen_at = now
        self._people = [person for person in self._people if now - person.seen_at <= _FORGET]
        self._now, self._pose = now, pose

    def advance(self, beats, v):
        """Open and close dialogues, once in a period. beats: how many have passed; v: the robot's speed."""
        for person in self._people:
            if person.fleeting:
                person.words, person.fleeting = 0.0 * person.words, False
            person.message_age = min(person.message_age + beats, _OLDEST) if person.message else 0
            person.request_age = min(person.request_age + beats, _OLDEST) if person.request else 0
            person.reply_age = min(person.reply_age + beats, _OLDEST) if person.reply else 0
            if not person.placed:
                continue
            distance = self._away(person)
            person.grown = person.grown + 1 if distance > person.distance else 0
            person.distance = distance
            if person.is_open and person.grown >= 2:
                person.close()
            elif person.seen and not person.met and self._comes_near(person, v):
                person.met = person.is_open = True
                person.grown = 0

    def speaker(self):
        """The person who is taken for the speaker of what was just said; somebody not yet seen where nobody is near."""
        found = speaker([(self._away(p), p.is_open, p.may_be_asked) for p in self._people])
        if found is not None:
            return self._people[found]
        person = self._somebody_new()
        person.seen_at = self._now
        return person

    def are_stood_for(self):
        """Whether the robot has promised somebody to stop, and may."""
        promises = [
            (p.message_age if p.message == _STOP else p.reply_age, p.placed and self._walks_into(p))
            for p in self._people
            if p.is_open and (p.message == _STOP or p.reply == _REFUSES)
        ]
        return stands(promises, self._rules)

    def who_owes_a_reply(self):
        """The nearest who was asked for something and has not answered, None if nobody was."""
        return self._closest(p for p in self._people if p.is_open and p.request and not p.reply)

    def ask(self, request):
        """Put the request to the nearest person who may be asked."""
        person = self._closest(p for p in self._people if p.may_be_asked)
        person.request, person.request_age = request, 0

    def observe(self):
        """{name: array} of the contract's inputs about people: the nearest, nearest first; who is seen comes before who
        is only remembered."""
        rows = sorted(self._people, key=lambda person: (not person.seen, self._away(person)))[: self._nearest]
        x, y, heading = self._pose
        cos, sin = math.cos(heading), math.sin(heading)
        seen = {
            "pedestrians": np.zeros((self._nearest, 4), np.float32),
            "words": np.zeros((self._nearest, self._dimensions), np.float32),
        }
        for k, person in enumerate(rows):
            seen["words"][k] = person.words
            if person.seen:
                dx, dy = person.x - x, person.y - y
                seen["pedestrians"][k] = (
                    cos * dx + sin * dy, cos * dy - sin * dx,
                    cos * person.vx + sin * person.vy, cos * person.vy - sin * person.vx,
                )  # fmt: skip
        columns = {
            "seen": "seen", "is_open": "is_open", "pedestrian_first": "first", "message_age": "message_age",
            "asked": "request", "request_age": "request_age", "reply": "reply", "message": "message",
            "spoken": "spoken",
        }  # fmt: skip
        for name, attribute in columns.items():
            column = [int(getattr(person, attribute)) for person in rows]
            seen[name] = np.array(column + [0] * (self._nearest - len(rows)), np.int32)
        seen["may_request"] = np.array(any(person.may_be_asked for person in self._people))
        return seen

    def _somebody_new(self):
        # Who was heard before being seen is the first to come into sight.
        for person in self._people:
            if not person.placed:
                return person
        self._people.append(Person(self._dimensions))
        return self._people[-1]

    def _away(self, person):
        return math.hypot(person.x - self._pose[0], person.y - self._pose[1]) if person.placed else math.inf

    def _walks_into(self, person):
        return walks_into((person.x, person.y, person.vx, person.vy), self._pose[:2], self._clearance, self._rules)

    def _closest(self, people):
        return min(people, key=self._away, default=None)

    def _comes_near(self, person, v):
        """Whether a dialogue opens: close enough, and soon to be closer still if both go on like this."""
        x, y, heading = self._pose
        px, py = person.x - x, person.y - y
        growth = (self._max_v + math.hypot(person.vx, person.vy)) / (self._max_v + _WALKING_SPEED)
        if math.hypot(px, py) >= self._gate["distance"] * max(growth, 1.0):
            return False
        vx, vy = person.vx - v * math.cos(heading), person.vy - v * math.sin(heading)
        when = -(px * vx + py * vy) / max(vx * vx + vy * vy, 1e-12)
        when = min(max(when, 0.0), self._gate["horizon"])
        return math.hypot(px + when * vx, py + when * vy) < self._gate["clearance"]
