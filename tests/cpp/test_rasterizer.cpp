// Which triangle each sample sees: coverage is exact, depth is close, the nearest wins.
#include "support.hpp"

#include <catch2/catch.hpp>

#include <algorithm>
#include <set>

using namespace shadelab;
using namespace shadelab::testing;

namespace {

constexpr int tile_pixels = tile_size * tile_size;
// The farthest that a projected vertex can lie: the guard band of 8192 pixels beyond a film of 16384.
constexpr int64_t lowest = -8192 * 256, highest = (16384 + 8192) * 256;

struct Triangulation {
    std::vector<Point> points;
    std::vector<std::array<int, 3>> triangles;
};

ScreenTriangle screen_triangle(Point a, Point b, Point c, uint32_t number, float z = 0.5f) {
    const auto vertex = [&](Point p) { return ScreenVertex{int32_t(p.x), int32_t(p.y), z}; };
    return {{vertex(a), vertex(b), vertex(c)}, number};
}

/// A grid that reaches beyond the tile at `origin` on all sides; the inner vertices are moved by less than a quarter of a
/// cell, which keeps every triangle's orientation. Returned in sub-pixels, some vertices exactly on pixel centres.
Triangulation jittered_grid(Random& random, glm::ivec2 origin, int64_t cell, int jitter) {
    Triangulation out;
    const int64_t margin = 2 * cell + 512, begin_x = origin.x * 256ll - margin, begin_y = origin.y * 256ll - margin;
    const int across = int((tile_size * 256 + 2 * margin) / cell) + 2;
    for (int j = 0; j <= across; ++j)
        for (int i = 0; i <= across; ++i) {
            Point p{begin_x + i * cell, begin_y + j * cell};
            if (jitter == 1)
                p = {p.x + random.integer(-(cell - 1) / 4, (cell - 1) / 4),
                     p.y + random.integer(-(cell - 1) / 4, (cell - 1) / 4)};
            out.points.push_back(p);
        }
    for (int j = 0; j < across; ++j)
        for (int i = 0; i < across; ++i) {
            const int a = j * (across + 1) + i, b = a + 1, c = a + across + 1, d = c + 1;
            if (random.integer(0, 1)) {
                out.triangles.push_back({a, b, d});
                out.triangles.push_back({a, d, c});
            } else {
                out.triangles.push_back({a, b, c});
                out.triangles.push_back({b, d, c});
            }
        }
    return out;
}

/// Random points put one by one into a square: whoever holds the point is cut into the triangles between the point and its
/// edges. Slivers of every shape, and edges that meet at points exactly on pixel centres and on samples.
Triangulation inserted_points(Random& random, glm::ivec2 origin, int64_t half_side, int count) {
    Triangulation out;
    const Point centre{origin.x * 256ll + 32 * 256, origin.y * 256ll + 32 * 256};
    for (const auto& [x, y] : {std::pair(-1, -1), {1, -1}, {1, 1}, {-1, 1}})
        out.points.push_back({centre.x + x * half_side, centre.y + y * half_side});
    out.triangles = {{0, 1, 2}, {0, 2, 3}};
    for (int n = 0; n < count; ++n) {
        const int64_t reach = std::min<int64_t>(half_side, 40 * 256);
        Point p{centre.x + random.integer(-reach, reach), centre.y + random.integer(-reach, reach)};
        const int64_t snap =
            std::array<int64_t, 4>{1, 32, 256, 256}[size_t(random.integer(0, 3))];  // 256: pixel centres
        p = {p.x / snap * snap, p.y / snap * snap};
        if (std::any_of(out.points.begin(), out.points.end(), [&](Point q) { return q.x == p.x && q.y == p.y; }))
            continue;
        const int number = int(out.points.size());
        out.points.push_back(p);
        std::vector<std::array<int, 3>> next;
        for (const std::array<int, 3>& t : out.triangles) {
            __int128 part[3];
            for (int k = 0; k < 3; ++k) part[k] = cross(out.points[t[k]], out.points[t[(k + 1) % 3]], p);
            if (part[0] < 0 || part[1] < 0 || part[2] < 0) {
                next.push_back(t);
                continue;
            }
            for (int k = 0; k < 3; ++k)
                if (part[k] > 0) next.push_back({t[k], t[(k + 1) % 3], number});
        }
        out.triangles.swap(next);
    }
    return out;
}

/// Draws all triangles twice, each with a depth of its own: once so that the last to cover a sample wins and once so that the
/// first wins. The number of samples that some triangle misses or that two triangles cover.
int miscovered_samples(Random& random, const Triangulation& mesh, glm::ivec2 origin, int samples) {
    VisibilityTile later = empty_tile(samples), earlier = empty_tile(samples);
    for (size_t i = 0; i < mesh.triangles.size(); ++i) {
        std::array<int, 3> t = mesh.triangles[i];
        if (random.integer(0, 1)) std::swap(t[0], t[1]);  // the orientation must not matter
        const float z = float(i + 1) / float(mesh.triangles.size() + 2);
        rasterize(screen_triangle(mesh.points[t[0]], mesh.points[t[1]], mesh.points[t[2]], uint32_t(i), 1 - z), origin,
                  samples, later);
        rasterize(screen_triangle(mesh.points[t[0]], mesh.points[t[1]], mesh.points[t[2]], uint32_t(i), z), origin,
                  samples, earlier);
    }
    int wrong = 0;
    for (size_t s = 0; s < later.triangle.size(); ++s)
        wrong += later.triangle[s] == no_triangle || later.triangle[s] != earlier.triangle[s];
    return wrong;
}

/// Corners of every size: around the tile, across it and through it from the ends of the fixed-point grid.
ScreenTriangle random_triangle(Random& random, glm::ivec2 origin, int kind) {
    const Point corner{origin.x * 256ll - 128, origin.y * 256ll - 128};
    const auto near_tile = [&](int64_t reach) {
        return Point{corner.x + random.integer(-reach, tile_size * 256 + reach),
                     corner.y + random.integer(-reach, tile_size * 256 + reach)};
    };
    const auto anywhere = [&] { return Point{random.integer(lowest, highest), random.integer(lowest, highest)}; };
    // The far end of a segment that starts in u and passes (to the nearest sub-pixel) through p.
    const auto beyond = [&](Point u, Point p) {
        double reach = 1e9;
        for (const auto& [from, to] : {std::pair(u.x, p.x), {u.y, p.y}})
            if (to != from) reach = std::min(reach, double((to > from ? highest : lowest) - to) / double(to - from));
        const double t = random.uniform(0, reach);
        const auto along = [&](int64_t from, int64_t to) {
            return std::clamp(to + int64_t(std::llround(t * double(to - from))), lowest, highest);
        };
        return Point{along(u.x, p.x), along(u.y, p.y)};
    };
    Point a, b, c;
    switch (kind) {
        case 0:  // smaller than a pixel or two
            a = near_tile(0);
            b = {a.x + random.integer(-400, 400), a.y + random.integer(-400, 400)};
            c = {a.x + random.integer(-400, 400), a.y + random.integer(-400, 400)};
            break;
        case 1:
            a = near_tile(0), b = near_tile(0), c = near_tile(0);
            break;
        case 2:
            a = near_tile(64 * 256), b = near_tile(64 * 256), c = near_tile(64 * 256);
            break;
        case 3:  // two huge edges through the tile
            a = anywhere();
            b = beyond(a, near_tile(0));
            c = beyond(a, near_tile(0));
            break;
        case 4:  // one huge edge through the tile
            a = anywhere();
            b = beyond(a, near_tile(0));
            c = anywhere();
            break;
        case 5:  // a sliver: both long edges pass within two sub-pixels of each other
            a = near_tile(20 * 256);
            b = near_tile(20 * 256);
            c = {b.x + random.integer(-2, 2), b.y + random.integer(-2, 2)};
            break;
        default: {  // edges through pixel centres, axis-aligned or diagonal
            const auto centre = [&] {
                return Point{(origin.x + random.integer(-4, 67)) * 256, (origin.y + random.integer(-4, 67)) * 256};
            };
            a = centre();
            b = random.integer(0, 1) ? Point{a.x, centre().y} : centre();
            c = random.integer(0, 1) ? Point{centre().x, a.y} : centre();
        }
    }
    const float z[3] = {float(random.uniform()), float(random.uniform()), float(random.uniform())};
    return {
        {{int32_t(a.x), int32_t(a.y), z[0]}, {int32_t(b.x), int32_t(b.y), z[1]}, {int32_t(c.x), int32_t(c.y), z[2]}},
        7};
}

glm::ivec2 random_origin(Random& random) {
    const int last = 16384 / tile_size - 1;
    switch (random.integer(0, 2)) {
        case 0:
            return {0, 0};
        case 1:
            return {last * tile_size, last * tile_size};
        default:
            return {int(random.integer(0, last)) * tile_size, int(random.integer(0, last)) * tile_size};
    }
}

}  // namespace

TEST_CASE("sample positions: n of them, no two in one row or column, the pixel's own") {
    for (int samples : {1, 2, 4, 8, 16, 64}) {
        const std::vector<glm::ivec2>& positions = sample_positions(samples);
        REQUIRE(int(positions.size()) == samples);
        std::set<int> columns, rows;
        glm::ivec2 sum(0);
        for (glm::ivec2 p : positions) {
            CHECK((p.x >= -128 && p.x < 128 && p.y >= -128 && p.y < 128));
            columns.insert(p.x);
            rows.insert(p.y);
            sum += p;
        }
        CHECK(int(columns.size()) == samples);
        CHECK(int(rows.size()) == samples);
        CHECK(sum == glm::ivec2(0));  // their centre is the pixel's: partial coverage does not shift edges
    }
    CHECK(sample_positions(1)[0] == glm::ivec2(0));
    // OpenGL's common 4x pattern with the rows counted upwards, as llvmpipe shows it (found by drawing, not from a document).
    std::set<std::pair<int, int>> four;
    for (glm::ivec2 p : sample_positions(4)) four.insert({p.x, p.y});
    CHECK(four == std::set<std::pair<int, int>>{{-32, -96}, {96, -32}, {-96, 32}, {32, 96}});
}

TEST_CASE("every sample of a triangulated plane is covered exactly once") {
    Random random(1);
    for (int samples : {1, 2, 4, 8, 16, 64}) {
        // Cells from a third of a pixel to larger than the tile. Unmoved ones of 128 and 256 have vertices on every pixel centre,
        // and their diagonals pass through samples.
        for (int64_t cell : {int64_t(88), int64_t(128), int64_t(256), int64_t(700), int64_t(3000), int64_t(30000)}) {
            if (samples > 8 && cell < 256) continue;  // time
            for (int jitter : {0, 1}) {
                const glm::ivec2 origin = random_origin(random);
                CAPTURE(samples, cell, jitter, origin.x, origin.y);
                CHECK(miscovered_samples(random, jittered_grid(random, origin, cell, jitter), origin, samples) == 0);
            }
        }
        for (int64_t half_side : {int64_t(40 * 256), int64_t(1) << 19, (highest - lowest) / 2 - 40 * 256}) {
            const glm::ivec2 origin(8192, 8192);
            CAPTURE(samples, half_side);
            CHECK(miscovered_samples(random, inserted_points(random, origin, half_side, 60), origin, samples) == 0);
        }
    }
}

TEST_CASE("coverage is that of exact arithmetic") {
    Random random(2);
    for (int samples : {1, 2, 4, 8, 16, 64}) {
        const int rounds = samples <= 4 ? 1400 : samples == 64 ? 70 : 280;
        int covered = 0, partly = 0;
        for (int round = 0; round < rounds; ++round) {
            const glm::ivec2 origin = random_origin(random);
            const ScreenTriangle t = random_triangle(random, origin, round % 7);
            VisibilityTile tile = empty_tile(samples);
            rasterize(t, origin, samples, tile);
            int wrong = 0, inside = 0;
            for (int s = 0; s < samples; ++s)
                for (int y = 0; y < tile_size; ++y)
                    for (int x = 0; x < tile_size; ++x) {
                        const bool expected =
                            covers_exactly(t, sample_at(origin + glm::ivec2(x, y), sample_positions(samples)[s]));
                        const size_t at = size_t((s * tile_size + y) * tile_size + x);
                        wrong += tile.triangle[at] != (expected ? 7 : no_triangle);
                        inside += expected;
                    }
            covered += inside > 0;
            partly += inside > 0 && inside < samples * tile_pixels;
            CAPTURE(samples, round % 7, origin.x, origin.y);
            CAPTURE(t.vertex[0].x, t.vertex[0].y, t.vertex[1].x, t.vertex[1].y, t.vertex[2].x, t.vertex[2].y);
            REQUIRE(wrong == 0);
        }
        CHECK(covered > rounds / 3);  // the test is about something
        CHECK(partly > rounds / 4);
    }
}

TEST_CASE("left and bottom edges own the samples on them, right and top edges do not") {
    // The rectangle from pixel centre (2, 3) to pixel centre (5, 7), as two triangles, in both orientations.
    for (bool flip : {false, true}) {
        VisibilityTile tile = empty_tile(1);
        const Point a{2 * 256, 3 * 256}, b{5 * 256, 3 * 256}, c{5 * 256, 7 * 256}, d{2 * 256, 7 * 256};
        rasterize(flip ? screen_triangle(a, c, b, 1) : screen_triangle(a, b, c, 1), {0, 0}, 1, tile);
        rasterize(flip ? screen_triangle(a, d, c, 1) : screen_triangle(a, c, d, 1), {0, 0}, 1, tile);
        for (int y = 0; y < tile_size; ++y)
            for (int x = 0; x < tile_size; ++x) {
                CAPTURE(x, y);
                CHECK((tile.triangle[size_t(y * tile_size + x)] == 1) == (x >= 2 && x < 5 && y >= 3 && y < 7));
            }
    }
}

TEST_CASE("a triangle without area covers nothing") {
    Random random(3);
    VisibilityTile tile = empty_tile(4);
    for (int i = 0; i < 300; ++i) {
        const Point a{random.integer(0, 63) * 256, random.integer(0, 63) * 256},
            step{random.integer(-64, 64), random.integer(-64, 64)};
        const int64_t m = random.integer(-9, 9), n = random.integer(-9, 9);
        rasterize(screen_triangle(a, {a.x + m * step.x, a.y + m * step.y}, {a.x + n * step.x, a.y + n * step.y}, 1),
                  {0, 0}, 4, tile);
    }
    CHECK(std::count(tile.triangle.begin(), tile.triangle.end(), 1u) == 0);
}

TEST_CASE("depth: within 4 x 2^-24 of the plane through the corners, and never outside the triangle's range") {
    // A height of 64 pixels or more keeps the depth of a whole tile row within [-1, 2] even where it is extrapolated. Then the
    // start of a row is rounded by up to 2^-24, the step times 63 by 2^-24, their product and their sum by 2^-25 each.
    Random random(4);
    int well_shaped = 0;
    double largest_error = 0;
    for (int round = 0; round < 3000; ++round) {
        const glm::ivec2 origin = random_origin(random);
        const ScreenTriangle t = random_triangle(random, origin, round % 7);
        const int samples = round % 3 == 0 ? 4 : 1;
        VisibilityTile tile = empty_tile(samples);
        rasterize(t, origin, samples, tile);
        Point v[3];
        for (int k = 0; k < 3; ++k) v[k] = {t.vertex[k].x, t.vertex[k].y};
        const __int128 area = cross(v[0], v[1], v[2]);
        double longest = 0;
        for (int k = 0; k < 3; ++k)
            longest =
                std::max(longest, std::hypot(double(v[k].x - v[(k + 1) % 3].x), double(v[k].y - v[(k + 1) % 3].y)));
        const bool measured = std::abs(double(area)) >= 64 * 256 * longest && longest > 0;
        well_shaped += measured;
        const float low = std::min({t.vertex[0].z, t.vertex[1].z, t.vertex[2].z}),
                    high = std::max({t.vertex[0].z, t.vertex[1].z, t.vertex[2].z});
        bool in_range = true;
        for (int s = 0; s < samples; ++s)
            for (int i = 0; i < tile_pixels; ++i) {
                const size_t at = size_t(s * tile_pixels + i);
                if (tile.triangle[at] == no_triangle) continue;
                in_range &= tile.depth[at] >= low && tile.depth[at] <= high;
                if (!measured) continue;
                const Point p =
                    sample_at(origin + glm::ivec2(i % tile_size, i / tile_size), sample_positions(samples)[s]);
                double truth = 0;
                for (int k = 0; k < 3; ++k)
                    truth += double(cross(v[(k + 1) % 3], v[(k + 2) % 3], p)) / double(area) * double(t.vertex[k].z);
                largest_error = std::max(largest_error, std::abs(truth - double(tile.depth[at])));
            }
        REQUIRE(in_range);
    }
    CHECK(well_shaped > 500);
    CHECK(largest_error <= 4 * 0x1p-24);
}

TEST_CASE("of two triangles the nearer wins, and of equal depths the first stays") {
    Random random(5);
    for (int samples : {1, 4}) {
        for (int round = 0; round < 20; ++round) {
            VisibilityTile together = empty_tile(samples), expected = empty_tile(samples);
            for (uint32_t number = 0; number < 40; ++number) {
                ScreenTriangle t = random_triangle(random, {0, 0}, int(number % 3));
                t.triangle = number;
                if (number % 2)
                    t.vertex[0].z = t.vertex[1].z = t.vertex[2].z = float(random.integer(1, 3)) / 4;  // many equal ones
                VisibilityTile alone = empty_tile(samples);
                rasterize(t, {0, 0}, samples, alone);
                rasterize(t, {0, 0}, samples, together);
                for (size_t s = 0; s < alone.depth.size(); ++s)
                    if (alone.triangle[s] == number && alone.depth[s] < expected.depth[s]) {
                        expected.depth[s] = alone.depth[s];
                        expected.triangle[s] = number;
                    }
            }
            CHECK((together.triangle == expected.triangle && together.depth == expected.depth));
        }
    }
    // Said once more without a loop: the same triangle twice, and one exactly on the cleared depth.
    VisibilityTile tile = empty_tile(1);
    const Point a{0, 0}, b{2560, 0}, c{0, 2560};
    rasterize(screen_triangle(a, b, c, 1, 1.0f), {0, 0}, 1, tile);
    CHECK(tile.triangle[0] == no_triangle);
    rasterize(screen_triangle(a, b, c, 2, 0.5f), {0, 0}, 1, tile);
    rasterize(screen_triangle(a, b, c, 3, 0.5f), {0, 0}, 1, tile);
    CHECK(tile.triangle[0] == 2);
    rasterize(screen_triangle(a, b, c, 4, std::nextafter(0.5f, 0.0f)), {0, 0}, 1, tile);
    CHECK(tile.triangle[0] == 4);
}
