"""Pictures: sizes, that every thing is drawn and looks different, films that read back, and bad input."""

from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from hrljax.envs.film import save_gif
from hrljax.envs.mario.drawing.figures import Pose, figure_image
from hrljax.envs.mario.drawing.picture import level_strip, screen
from hrljax.envs.mario.drawing.tiles import tile_image
from hrljax.envs.mario.engine.course import make_course, start
from hrljax.envs.mario.engine.state import SHELL
from hrljax.envs.mario.levels.generator import generate_level
from hrljax.envs.mario.levels.tiles import BRICK_COIN, EMPTY, TILES

LEVEL = generate_level(1247, 0, 3)
COURSE = make_course(LEVEL)
GAME = start(COURSE)


def luminance(image: Image.Image) -> np.ndarray:
    """Grey values over white: what is left of a drawing without colours."""
    return np.asarray(Image.alpha_composite(Image.new("RGBA", image.size, "white"), image).convert("L"), np.float64)


def test_the_screen_shows_mario_where_he_is():
    player = GAME.player._replace(x=jnp.float32(200.0), y=jnp.float32(100.0))
    with_mario = screen(COURSE, GAME._replace(player=player, camera=jnp.float32(40.0)), 16, status=False)
    away = screen(
        COURSE, GAME._replace(player=player._replace(y=jnp.float32(-99.0)), camera=jnp.float32(40.0)), 16, False
    )
    assert with_mario.shape == (240, 320, 3)
    assert with_mario.dtype == np.uint8
    rows, columns = np.nonzero((with_mario != away).any(axis=-1))
    assert 145 <= columns.min() < 160 < columns.max() <= 175
    assert 82 <= rows.min() < rows.max() <= 101


def test_the_screen_follows_the_camera():
    still, moved = (screen(COURSE, GAME._replace(camera=jnp.float32(x)), 16, False) for x in (0.0, 16.0))
    below_mario = slice(150, 240)
    np.testing.assert_array_equal(moved[below_mario, :-16], still[below_mario, 16:])


def test_any_columns_may_be_shown():
    seen = screen(COURSE, GAME._replace(camera=jnp.float32(32.0)), 16, False)
    np.testing.assert_array_equal(screen(COURSE, GAME, 16, False, columns=(2, 22)), seen)
    part = screen(COURSE, GAME, 16, False, columns=(5, 30))
    assert part.shape == (240, 25 * 16, 3)
    np.testing.assert_array_equal(part[150:, : 17 * 16], seen[150:, 3 * 16 :])
    for columns in ((-1, 5), (5, 5), (0, 371)):
        with pytest.raises(ValueError, match="columns must be two of"):
            screen(COURSE, GAME, columns=columns)


def test_the_screen_shows_sprites_and_what_they_are():
    sprites, seen = GAME.sprites, []
    for kind in range(1, 10):
        placed = sprites._replace(
            kind=sprites.kind.at[0].set(kind), x=sprites.x.at[0].set(100.0), y=sprites.y.at[0].set(150.0)
        )
        seen.append(screen(COURSE, GAME._replace(sprites=placed, num_sprites=jnp.int32(1)), 16, False))
    assert all((a != b).any() for a, b in combinations([*seen, screen(COURSE, GAME, 16, False)], 2))


def test_status_counts_coins():
    pictures = [screen(COURSE, GAME._replace(coins=jnp.int32(coins))) for coins in (0, 7)]
    assert pictures[0].shape == (480, 640, 3)
    rows = np.nonzero((pictures[0] != pictures[1]).any(axis=(1, 2)))[0]
    assert len(rows)
    assert rows.max() < 32


@pytest.mark.parametrize("level_type", [0, 1, 2])
def test_the_strip_shows_the_whole_level(level_type):
    level = generate_level(3, level_type, 5, 150)
    whole = level_strip(level, 8)
    assert whole.shape == (15 * 8 + 10, 200 * 8, 3)
    assert whole.dtype == np.uint8
    wrapped = level_strip(level, 8, columns=80)
    assert wrapped.shape == (3 * (15 * 8 + 10), 80 * 8, 3)
    np.testing.assert_array_equal(wrapped[130:250, : 80 * 8 - 40][:, 40:], whole[:120, 80 * 8 + 40 : 160 * 8 - 40])
    assert (wrapped[2 * 130 : -10, 45 * 8 :] == 255).all()  # nothing beyond the level


def test_monsters_exit_and_track_are_on_the_strip():
    bare = level_strip(LEVEL._replace(spawns=np.zeros_like(LEVEL.spawns), exit_column=369), 16)
    changed = (level_strip(LEVEL, 16) != bare).any(axis=(0, 2))
    for column in [*np.nonzero(LEVEL.spawns)[0], 318]:
        assert changed[column * 16 : column * 16 + 16].any()
    track = np.array([[32.0, 100.0], [320.0, 100.0]])
    rows, columns = np.nonzero((level_strip(LEVEL, 16, track=track) != level_strip(LEVEL, 16)).any(axis=-1))
    assert (columns.min(), columns.max()) == (32, 320)
    assert rows.max() - rows.min() < 4


def test_tiles_that_differ_look_different():
    drawn = {tile: tile_image(tile, 32) for tile in TILES if tile != EMPTY}
    assert tile_image(EMPTY, 32) is None
    assert all(image is not None and image.size == (32, 32) for image in drawn.values())
    alike = [
        (a, b)
        for (a, first), (b, second) in combinations(drawn.items(), 2)
        if first is not None and second is not None and first.tobytes() == second.tobytes()
    ]
    # Hill tops without a rounded corner are the same in the middle of a hill and of a joined one.
    assert alike == [(0x85, 0xB5)]


def test_figures_differ_without_colours_too():
    poses = [Pose(0), Pose(0, 1), Pose(0, 2), *map(Pose, range(1, 10)), Pose(SHELL, 1), Pose(1, winged=True)]
    drawn = [luminance(figure_image(pose, 32)) for pose in poses]
    for (a, first), (b, second) in combinations(zip(poses, drawn, strict=True), 2):
        assert np.count_nonzero(np.abs(first - second) > 40) >= 12, (a, b)


def test_figures_turn_and_stand_on_their_feet():
    for kind in (0, 1, 2, 3, 4, 6, 7, 8, 9):
        image = figure_image(Pose(kind), 32)
        box = image.getbbox()
        assert box is not None
        assert kind == 8 or box[3] == 34 * 2
        mirrored = np.asarray(figure_image(Pose(kind, left=True), 32))
        np.testing.assert_array_equal(mirrored, np.asarray(image)[:, ::-1])


def test_films_keep_the_colour_of_small_things(tmp_path):
    frames = [screen(COURSE, GAME._replace(camera=jnp.float32(x)), 16) for x in (0.0, 500.0)]
    frames[1][100:104, 100:104] = (213, 94, 0)
    save_gif(frames, tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as film:
        film.seek(1)
        shown = np.asarray(film.convert("RGB")).astype(int)
    assert np.abs(shown[101, 101] - (213, 94, 0)).max() < 24


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="tile_pixels must be an integer from 4 to 2147483647, got 3"):
        screen(COURSE, GAME, 3)
    with pytest.raises(ValueError, match="columns must be an integer from 1 to 2147483647, got 0"):
        level_strip(LEVEL, columns=0)
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), GAME)
    with pytest.raises(ValueError, match=r"world must be one game, got a batch of shape \[2\]"):
        screen(COURSE, batch)


def test_what_a_block_hides_is_marked():
    assert BRICK_COIN in TILES
    coin, plain = (np.asarray(tile_image(tile, 32)) for tile in (BRICK_COIN, 0x10))
    assert (coin[10:22, 12:20] != plain[10:22, 12:20]).any()
