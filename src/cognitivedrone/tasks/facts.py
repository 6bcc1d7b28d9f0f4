"""Facts about the drawn things: the table behind the `association` and `food` families.

A fact is a phrase, the concepts for which it clearly holds and those for which it clearly does not. Debatable
concepts are in neither set, so a task built from a fact never has two right answers. Animals, foods and objects
share one namespace. The last phrase of every fact is held out for `unseen`.
"""

from __future__ import annotations

from dataclasses import dataclass

from cognitivedrone.tasks import vocabulary

KIND_OF: dict[str, str] = {
    **dict.fromkeys(vocabulary.ANIMALS, "animal"),
    **dict.fromkeys(vocabulary.FOODS, "food"),
    **dict.fromkeys(vocabulary.OBJECTS, "object"),
}
"""Kind of every drawn concept."""


@dataclass(frozen=True, slots=True)
class Fact:
    """Synonymous phrases, and the concepts for which they are true and false."""

    phrases: tuple[str, ...]
    """Noun phrases that follow "the gate with"; the last one is held out."""
    true: tuple[str, ...]
    false: tuple[str, ...]


def _names(words: str) -> frozenset[str]:
    return frozenset(words.split())


def _fact(true: str | frozenset[str], false: frozenset[str], *phrases: str) -> Fact:
    holds = _names(true) if isinstance(true, str) else true
    return Fact(phrases, tuple(sorted(holds)), tuple(sorted(false - holds)))


# Building blocks for the sets below. None claims to be complete.
_MAMMALS = _names(
    "gorilla dog wolf fox raccoon cat lion tiger leopard horse zebra deer bison cow pig boar sheep goat camel llama giraffe "
    "elephant rhinoceros hippopotamus mouse rat hamster rabbit chipmunk hedgehog bear polar_bear koala panda sloth skunk "
    "kangaroo badger"
)
_FLYERS = _names("dove eagle duck swan owl parrot flamingo")
_BIRDS = _FLYERS | _names("penguin chicken rooster peacock turkey")
_INSECTS = _names("butterfly ant bee beetle ladybug cricket mosquito")
_REPTILES = _names("crocodile turtle lizard snake")
_FISH = _names("fish blowfish shark")
_WILD = _names(
    "lion tiger elephant giraffe zebra rhinoceros hippopotamus polar_bear shark whale octopus penguin crocodile"
)
_FRUIT = _names(
    "apple green_apple pear orange banana watermelon grapes strawberry blueberries melon cherries peach mango pineapple kiwi"
)
_VEGETABLES = _names("carrot broccoli lettuce onion potato garlic")
_DRINKS = _names("milk coffee tea wine beer whiskey champagne soda")
_SWEETS = _names("ice_cream donut cookie birthday_cake cupcake chocolate candy lollipop honey")
_MEAT = _names("steak bacon chicken_leg")
_DISHES = _names("pizza spaghetti taco burrito sushi burger hot_dog ramen curry sandwich")
_BAKED = _names("croissant bagel bread baguette pretzel")
_TOOLS = _names("hammer wrench screwdriver magnet ladder bucket broom")
_FURNITURE = _names("mirror bathtub bed chair door window")
_OFFICE = _names("pencil ruler paperclip envelope book newspaper floppy_disk keyboard computer_mouse printer")
_CLOTHES = _names("shirt jeans dress scarf gloves socks sneaker boot high_heel top_hat")
_ROAD = _names("car taxi bus truck tractor")
_INSTRUMENTS = _names("guitar violin trumpet drum saxophone accordion")
_BALLS = _names("soccer_ball basketball baseball volleyball")
_THINGS = (
    (_TOOLS | _FURNITURE | _OFFICE | _CLOTHES | _ROAD | _INSTRUMENTS | _BALLS)
    | _names("key lock spoon teapot coin trophy teddy_bear gift puzzle_piece soap kite anchor umbrella")
)  # fmt: skip
_ANIMALS = _MAMMALS | _BIRDS | _INSECTS | _REPTILES | _FISH | _names("whale dolphin octopus spider frog snail worm")
_FOODS = _FRUIT | _VEGETABLES | _DRINKS | _SWEETS | _MEAT | _DISHES | _BAKED | _names("cheese butter egg rice corn")

GROUPS: dict[str, frozenset[str]] = {
    "bird": _BIRDS | {"chick"},
    "mammal": _MAMMALS,
    "insect": _INSECTS,
    "reptile": _REPTILES,
    "fish": _FISH,
    "fruit": _FRUIT,
    "vegetable": _VEGETABLES,
    "drink": _DRINKS,
    "dessert": _SWEETS,
    "meat": _MEAT,
    "dish": _DISHES,
    "pastry": _BAKED,
    "tool": _TOOLS,
    "furniture": _FURNITURE,
    "clothing": _CLOTHES,
    "vehicle": _ROAD | _names("train bicycle motorcycle ambulance fire_engine police_car airplane helicopter sailboat"),
    "instrument": _INSTRUMENTS,
    "ball": _BALLS,
    "flower": _names("sunflower rose tulip"),
}
"""Concepts by common group name. No group claims to be complete."""

HEALTHY: tuple[str, ...] = (
    "apple", "green_apple", "pear", "orange", "banana", "watermelon", "grapes", "strawberry", "blueberries",
    "melon", "cherries", "peach", "mango", "pineapple", "kiwi", "tomato", "avocado", "broccoli", "lettuce",
    "cucumber", "carrot", "bell_pepper", "salad",
)  # fmt: skip
"""Plain fruit and vegetables; nothing sweetened, salted, fried or starchy."""
UNHEALTHY: tuple[str, ...] = (
    "burger", "fries", "pizza", "hot_dog", "bacon", "donut", "cookie", "birthday_cake", "cupcake", "chocolate",
    "candy", "lollipop", "ice_cream", "soda", "beer", "whiskey", "champagne", "wine",
)  # fmt: skip
"""Fast food, sweets and alcohol."""

# ruff: noqa: E501  (one fact per line keeps the table readable)
FACTS: tuple[Fact, ...] = (
    # Animals.
    _fact(_BIRDS | _names("crocodile turtle frog"), _MAMMALS, "the animal that lays eggs", "an animal that lays eggs", "an animal that hatches from an egg"),
    _fact(_FLYERS | _names("bee butterfly mosquito bat ladybug"), _MAMMALS | _REPTILES | _FISH | _names("penguin snail worm"), "the animal that can fly", "an animal that can fly", "the animal that is able to fly"),
    _fact("penguin", _FLYERS | _MAMMALS, "the bird that cannot fly", "a bird that is unable to fly"),
    _fact("whale dolphin shark octopus squid lobster", _MAMMALS - {"polar_bear"} | _INSECTS | _FLYERS - {"duck", "swan", "flamingo"}, "the animal that lives in the sea", "an animal that lives in the sea", "the animal whose home is the ocean"),
    _fact(_INSECTS, _MAMMALS | _BIRDS | _REPTILES | _FISH, "the insect", "an insect", "an animal with six legs"),
    _fact("spider scorpion", _MAMMALS | _BIRDS | _INSECTS | _names("snake fish worm"), "the animal with eight legs", "an animal that walks on eight legs"),
    _fact("snake worm", _MAMMALS | _BIRDS | _INSECTS | _names("spider frog lizard crocodile"), "the animal without legs", "an animal that has no legs"),
    _fact("zebra", _ANIMALS - {"tiger", "badger", "skunk", "bee", "raccoon"}, "the animal with black and white stripes", "an animal that is striped in black and white"),
    _fact("elephant mammoth", _ANIMALS, "the animal with a trunk", "an animal that has a trunk"),
    _fact("giraffe", _names("pig mouse frog hedgehog rat hamster bear cat rabbit hippopotamus rhinoceros bee panda fish lion"), "the animal with a very long neck", "the tallest animal"),
    _fact("cow goat", _BIRDS | _INSECTS | _REPTILES | _FISH, "the animal that gives us milk", "an animal that people milk"),
    _fact("bee", _ANIMALS - {"mosquito", "beetle"}, "the animal that makes honey", "the animal that lives in a beehive"),
    _fact("sheep", _ANIMALS - {"llama", "goat", "rabbit"}, "the animal that gives us wool", "the animal that is shorn for its wool"),
    _fact("turtle snail", _MAMMALS | _BIRDS | _names("snake worm frog octopus shark"), "the animal with a shell", "an animal that carries its house on its back"),
    _fact("kangaroo", _ANIMALS - {"koala"}, "the animal that carries its young in a pouch", "an animal with a pouch for its baby"),
    _fact("camel", _ANIMALS - {"bison", "llama", "boar", "whale", "bear"}, "the animal with a hump", "an animal that has a hump on its back"),
    _fact("lion", _ANIMALS - {"tiger", "leopard"}, "the king of the animals", "the big cat with a mane"),
    _fact("spider", _ANIMALS - {"ant"}, "the animal that spins a web", "an animal that catches flies in a web"),
    _fact("dog", _ANIMALS - {"wolf", "fox"}, "the animal that barks", "an animal that says woof"),
    _fact("cat", _ANIMALS - {"lion", "tiger", "leopard"}, "the animal that meows", "an animal that says meow"),
    _fact("rooster", _ANIMALS - {"chicken", "turkey", "peacock"}, "the animal that crows in the morning", "an animal that wakes the farm"),
    _fact("hedgehog", _ANIMALS - {"blowfish", "fish", "lizard"}, "the animal with spines", "an animal with a prickly back"),
    _fact("beaver", _ANIMALS, "the animal that builds dams", "an animal that dams up rivers"),
    _fact("owl", _names("dove eagle chicken parrot rooster peacock penguin turkey swan"), "the bird that hunts at night", "a bird that is awake at night"),
    _fact("cow pig sheep chicken rooster", _WILD | _names("wolf leopard snake bear"), "the farm animal", "a farm animal", "an animal that lives on a farm"),
    _fact("dog cat hamster", _WILD - {"octopus"} | _names("bison bear gorilla wolf"), "the animal that people keep as a pet", "a popular pet"),
    _fact(_REPTILES, _MAMMALS | _BIRDS | _INSECTS | _FISH, "the reptile", "a reptile", "the animal that is a reptile"),
    _fact("octopus", _ANIMALS - {"spider"}, "the animal with eight arms", "an animal that has eight arms"),
    _fact("polar_bear", _names("lion giraffe camel gorilla zebra elephant koala kangaroo parrot flamingo crocodile panda monkey"), "the animal that lives in the Arctic", "an animal of the far north"),
    _fact("panda", _names("lion tiger shark eagle snake owl whale frog cat wolf dolphin bee leopard crocodile"), "the animal that eats bamboo", "the animal that feeds on bamboo"),
    _fact("bee scorpion", _names("cow horse rabbit sheep giraffe duck owl frog penguin koala panda elephant snail turtle butterfly"), "the animal that can sting", "an animal with a sting"),
    _fact("parrot", _ANIMALS, "the animal that can repeat words", "an animal that can learn to speak"),
    _fact("frog", _ANIMALS, "the animal that a tadpole turns into", "what a tadpole becomes"),
    _fact("whale", _ANIMALS, "the largest animal of all", "the biggest animal on Earth"),
    # Foods and drinks.
    _fact(_FRUIT, _DISHES | _BAKED | _SWEETS | _MEAT | _DRINKS - {"wine", "champagne"}, "the fruit", "a fruit", "a piece of fruit"),
    _fact(_VEGETABLES, _FRUIT | _SWEETS | _DRINKS | _MEAT | _BAKED, "the vegetable", "a vegetable", "something that is a vegetable"),
    _fact("soda bubble_tea juice_box", _names("beer whiskey lemon salt cheese bread steak broccoli egg butter"), "the sweet drink", "a sweet drink", "something sweet to drink"),
    _fact("lemon", _names("banana watermelon mango melon pear peach"), "the sour fruit", "a fruit that tastes sour"),
    _fact("banana lemon", _names("strawberry blueberries cherries watermelon kiwi coconut"), "the yellow fruit", "a fruit that is yellow"),
    _fact("beer wine whiskey champagne", _names("milk tea juice_box soda bubble_tea"), "the drink with alcohol", "an alcoholic drink", "a drink for adults only"),
    _fact("coffee tea", _names("beer champagne soda juice_box whiskey"), "the hot drink", "a hot drink", "a drink that is served hot"),
    _fact("milk", _DRINKS, "the drink that comes from a cow", "a drink that calves like too"),
    _fact("ice_cream shaved_ice", _SWEETS | _BAKED | _DISHES, "the frozen dessert", "a frozen dessert", "something sweet and icy"),
    _fact(_MEAT, _FRUIT | _VEGETABLES | _SWEETS - {"candy", "lollipop"} | _BAKED, "the meat", "some meat", "something that vegetarians do not eat"),
    _fact("sushi bento rice_ball", _names("pizza spaghetti taco burrito burger hot_dog baguette croissant pretzel"), "the Japanese dish", "a dish from Japan"),
    _fact("pizza spaghetti", _names("sushi taco burrito burger bento pretzel rice_ball curry"), "the Italian dish", "a dish from Italy"),
    _fact("taco burrito", _names("sushi pizza spaghetti bento croissant pretzel rice_ball ramen"), "the Mexican dish", "a dish from Mexico"),
    _fact("honey", _FOODS, "the food that bees make", "what bees make"),
    _fact("chili_pepper", _FRUIT | _SWEETS | _BAKED | _names("milk rice egg butter"), "the spicy food", "something that burns your tongue"),
    _fact("salt pretzel fries bacon", _SWEETS | _FRUIT, "the salty food", "something salty", "food that tastes of salt"),
    _fact("birthday_cake", _FOODS - {"cupcake", "donut", "ice_cream"}, "the food for a birthday", "something to put birthday candles on"),
    _fact("cheese butter", _FRUIT | _VEGETABLES | _MEAT | _names("rice corn tea wine"), "the food that is made from milk", "a dairy product"),
    _fact("cherries peach mango", _names("banana strawberry watermelon orange pineapple kiwi apple pear"), "the fruit with a stone inside", "a stone fruit"),
    _fact("carrot potato onion garlic sweet_potato", _FRUIT | _names("corn eggplant tomato lettuce broccoli"), "the food that grows under the ground", "a plant that is dug out of the soil"),
    _fact("onion", _FRUIT | _VEGETABLES - {"garlic"} | _names("corn tomato cucumber"), "the vegetable that makes you cry", "what brings tears to the cook"),
    _fact("egg", _FOODS, "the food that hens lay", "what a hen lays"),
    # Objects.
    _fact("umbrella", _OFFICE - {"newspaper", "book"} | _INSTRUMENTS | _BALLS | _TOOLS | _names("star volcano rose fire"), "something that keeps you dry", "the thing that keeps you dry in the rain", "protection from the rain"),
    _fact("chair couch", _TOOLS - {"bucket", "ladder"} | _OFFICE | _CLOTHES | _INSTRUMENTS - {"drum"} | _names("mirror lock spoon coin trophy window"), "something you can sit on", "the thing to sit on", "a seat"),
    _fact("bed", _TOOLS | _OFFICE | _CLOTHES | _INSTRUMENTS | _BALLS, "something you sleep in", "the place to sleep"),
    _fact("watch alarm_clock", _TOOLS | _CLOTHES | _INSTRUMENTS | _BALLS | _FURNITURE, "something that tells the time", "the thing that shows the time", "a clock"),
    _fact("scissors saw knife axe", _CLOTHES | _FURNITURE | _INSTRUMENTS | _BALLS | _names("spoon magnet broom bucket book"), "something that cuts", "the thing to cut with", "something with a sharp blade"),
    _fact("hammer", _CLOTHES | _FURNITURE | _INSTRUMENTS | _OFFICE | _names("broom saw scissors magnet bucket spoon"), "the tool for driving nails", "what you hit nails with"),
    _fact("key", _THINGS - {"lock", "door", "paperclip"}, "something that opens a lock", "what you unlock a door with"),
    _fact(_INSTRUMENTS, _TOOLS | _FURNITURE | _CLOTHES | _ROAD | _BALLS, "the musical instrument", "something to play music on", "an instrument"),
    _fact("guitar violin", _names("trumpet drum saxophone accordion"), "the instrument with strings", "a string instrument"),
    _fact("trumpet saxophone", _names("guitar violin drum"), "the instrument you blow into", "a wind instrument"),
    _fact("drum", _names("guitar violin trumpet saxophone accordion"), "the instrument you beat with sticks", "a percussion instrument"),
    _fact(_BALLS, _TOOLS | _FURNITURE | _OFFICE | _CLOTHES | _ROAD, "the ball", "a ball", "a ball for a sport"),
    _fact("sneaker boot high_heel", _names("gloves scarf top_hat shirt crown umbrella ring watch"), "something you wear on your feet", "footwear"),
    _fact("top_hat crown", _names("boot sneaker socks gloves jeans shirt ring watch high_heel"), "something you wear on your head", "headwear"),
    _fact("gloves", _CLOTHES | _TOOLS, "something that keeps your hands warm", "clothing for the hands"),
    _fact("airplane helicopter", _ROAD | _names("bicycle train sailboat canoe motorcycle skateboard"), "the vehicle that flies", "a vehicle that can fly", "an aircraft"),
    _fact("bicycle motorcycle", _ROAD | _names("train sailboat helicopter canoe rocket"), "the vehicle with two wheels", "a vehicle on two wheels"),
    _fact("train", _ROAD | _names("bicycle sailboat helicopter canoe rocket motorcycle"), "the vehicle that runs on rails", "a vehicle that needs a track of steel"),
    _fact("sailboat canoe", _ROAD | _names("train bicycle helicopter motorcycle ambulance"), "the vehicle that floats on water", "a boat"),
    _fact("fire_engine fire_extinguisher", _ROAD | _OFFICE | _CLOTHES | _names("train bicycle candle radio"), "something for putting out fires", "help against a fire"),
    _fact("ambulance", _names("train bicycle tractor sailboat canoe rocket motorcycle skateboard"), "the vehicle that brings people to the hospital", "the vehicle for sick people"),
    _fact("tractor", _names("train bicycle taxi sailboat fire_engine canoe rocket ambulance police_car bus"), "the vehicle that works on fields", "the vehicle a farmer drives"),
    _fact("telescope", _THINGS - {"window", "mirror"}, "something for looking at the stars", "what an astronomer looks through"),
    _fact("thermometer", _THINGS, "something that measures a fever", "what measures the temperature"),
    _fact("stethoscope", _THINGS, "what a doctor listens to your heart with", "a tool for hearing heartbeats"),
    _fact("light_bulb candle flashlight", _TOOLS | _CLOTHES | _BALLS | _INSTRUMENTS | _names("lock spoon bed chair coin anchor"), "something that gives light", "the thing that lights up the dark", "a source of light"),
    _fact("pencil pen", _TOOLS | _FURNITURE | _CLOTHES | _BALLS | _INSTRUMENTS, "something to write with", "a writing tool"),
    _fact("book newspaper", _TOOLS | _FURNITURE | _CLOTHES | _BALLS | _INSTRUMENTS, "something to read", "the thing to read", "reading matter"),
    _fact("toothbrush", _THINGS, "something for cleaning your teeth", "what keeps your teeth clean"),
    _fact("broom", _THINGS, "something for sweeping the floor", "what you sweep with"),
    _fact("camera", _THINGS, "something that takes pictures", "what a photographer uses"),
    _fact("compass", _THINGS, "something that shows where north is", "an instrument that points north"),
    _fact("cactus", _names("tulip rose sunflower tree"), "the plant that lives in the desert", "a plant of hot and dry places"),
    _fact("sunflower rose tulip", _names("tree palm_tree cactus cloud rainbow volcano star fire"), "the flower", "a flower", "something for a bouquet"),
    _fact("abacus", _CLOTHES | _BALLS | _INSTRUMENTS | _FURNITURE | _TOOLS, "something to do sums with", "a tool for arithmetic"),
    _fact("rainbow", _THINGS | _names("volcano cactus tree"), "what appears in the sky after rain", "an arch of seven colours"),
    _fact("volcano", _THINGS | _names("rainbow cloud tree cactus"), "something that spits lava", "a mountain that erupts"),
    _fact("magnet", _CLOTHES | _names("broom bucket soap candle book chair umbrella"), "something that attracts iron", "what pulls iron towards it"),
    _fact("parachute", _ROAD | _FURNITURE | _TOOLS | _BALLS, "what you need when you jump out of an airplane", "something for a slow fall"),
    _fact("ladder", _names("bucket broom soap lock spoon mirror bathtub candle book magnet"), "something for climbing up high", "a thing with rungs"),
    _fact("anchor", _THINGS, "what holds a ship in place", "something that is dropped from a ship"),
    _fact("bandage", _THINGS - {"soap", "scarf"}, "something to put on a cut", "what covers a small wound"),
)  # fmt: skip
"""Facts about animals, foods and objects; `reasoning.association` has those about numbers and letters."""
