// Clipping against near, far and guard planes, and projection onto the sub-pixel grid.
#include "support.hpp"

#include "raster/rasterize.hpp"

#include <catch2/catch.hpp>

#include <glm/gtc/matrix_transform.hpp>

#include <algorithm>

using namespace shadelab;
using namespace shadelab::testing;

namespace {

constexpr double guard_pixels = 8192;

/// The visible part of a triangle in double: cut by one plane after the other, then projected to sub-pixels. `error`: how far
/// (in sub-pixels) float32 may move a corner. Snapping: half a sub-pixel in x and y, 0.71 along the diagonal. A cut, one after
/// the other for at most three planes at a corner: 2^-24 of the largest coordinate for t, the difference, the product and the
/// sum, so 12 in all; divided by w, and for the error of w itself times x / w.
std::vector<glm::dvec2> visible_polygon(const glm::vec4 clip[3], int width, int height, double& error) {
    double largest = 0;
    for (int k = 0; k < 3; ++k)
        for (int c = 0; c < 4; ++c) largest = std::max(largest, std::abs(double(clip[k][c])));
    const double gx = 1 + 2 * guard_pixels / width, gy = 1 + 2 * guard_pixels / height;
    std::vector<glm::dvec4> polygon(clip, clip + 3);
    for (const glm::dvec4 plane :
         {glm::dvec4(0, 0, 1, 1), {0, 0, -1, 1}, {1, 0, 0, gx}, {-1, 0, 0, gx}, {0, 1, 0, gy}, {0, -1, 0, gy}}) {
        std::vector<glm::dvec4> kept;
        for (size_t i = 0; i < polygon.size(); ++i) {
            const glm::dvec4 a = polygon[i], b = polygon[(i + 1) % polygon.size()];
            const double da = glm::dot(plane, a), db = glm::dot(plane, b);
            if (da >= 0) kept.push_back(a);
            if ((da >= 0) != (db >= 0)) kept.push_back(a + da / (da - db) * (b - a));
        }
        polygon.swap(kept);
    }
    std::vector<glm::dvec2> out;
    error = 0.71;
    for (const glm::dvec4& p : polygon)
        error =
            std::max(error, 0.71 + 12 * 0x1p-24 * largest / p.w * (1 + std::max(std::abs(p.x), std::abs(p.y)) / p.w) *
                                       std::max(width, height) / 2 * 256);
    for (const glm::dvec4& p : polygon)
        out.push_back({((p.x / p.w + 1) * width / 2 - 0.5) * 256, ((p.y / p.w + 1) * height / 2 - 0.5) * 256});
    return out;
}

double area_of(const std::vector<glm::dvec2>& polygon) {
    double sum = 0;
    for (size_t i = 1; i + 1 < polygon.size(); ++i) {
        const glm::dvec2 a = polygon[i] - polygon[0], b = polygon[i + 1] - polygon[0];
        sum += (a.x * b.y - a.y * b.x) / 2;
    }
    return sum;
}

double perimeter_of(const std::vector<glm::dvec2>& polygon) {
    double sum = 0;
    for (size_t i = 0; i < polygon.size(); ++i) sum += glm::length(polygon[(i + 1) % polygon.size()] - polygon[i]);
    return sum;
}

double area_of(const ScreenTriangle& t) {
    const ScreenVertex* v = t.vertex;
    return double(cross({v[0].x, v[0].y}, {v[1].x, v[1].y}, {v[2].x, v[2].y})) / 2;
}

bool same_place(const ScreenVertex& a, const ScreenVertex& b) { return a.x == b.x && a.y == b.y; }

/// Draws the pieces of all triangles twice: so that of each sample the first and so that the last to cover it is seen.
struct Coverage {
    VisibilityTile first = empty_tile(1), last = empty_tile(1);
    int drawn = 0;

    void add(ScreenTriangle t) {
        ++drawn;
        t.triangle = uint32_t(drawn);
        const float z = float(drawn) / 65536;
        for (ScreenVertex& v : t.vertex) v.z = z;
        rasterize(t, {0, 0}, 1, first);
        for (ScreenVertex& v : t.vertex) v.z = 1 - z;
        rasterize(t, {0, 0}, 1, last);
    }
    bool missed(int x, int y) const { return first.triangle[size_t(y * tile_size + x)] == no_triangle; }
    bool once(int x, int y) const {
        const size_t at = size_t(y * tile_size + x);
        return !missed(x, y) && first.triangle[at] == last.triangle[at];
    }
};

}  // namespace

TEST_CASE("projection: window coordinates on the sub-pixel grid, depth from 0 to 1") {
    // The centre of the bottom-left pixel is (0, 0); the film's bottom-left corner lies half a pixel (128) below and left of it.
    const ScreenVertex corner = project({-1, -1, -1, 1}, 640, 480), centre = project({0, 0, 0, 2}, 640, 480),
                       far = project({3, 3, 3, 3}, 640, 480);
    CHECK((corner.x == -128 && corner.y == -128 && corner.z == 0));
    CHECK((centre.x == 320 * 256 - 128 && centre.y == 240 * 256 - 128 && centre.z == 0.5f));
    CHECK((far.x == 640 * 256 - 128 && far.y == 480 * 256 - 128 && far.z == 1));

    // Float window coordinates up to 512 resolve 2^-15 pixels (1/128 sub-pixel); x/w adds 2^-24 x 256 pixels, half of that.
    Random random(10);
    for (int i = 0; i < 10000; ++i) {
        const glm::vec4 p(random.uniform(-5, 5), random.uniform(-5, 5), random.uniform(-5, 5), random.uniform(5, 20));
        const ScreenVertex v = project(p, 512, 384);
        const double x = ((double(p.x) / p.w + 1) * 256 - 0.5) * 256, y = ((double(p.y) / p.w + 1) * 192 - 0.5) * 256;
        CHECK(std::abs(v.x - x) <= 0.5 + 1.0 / 64);
        CHECK(std::abs(v.y - y) <= 0.5 + 1.0 / 64);
        CHECK(std::abs(v.z - (double(p.z) / p.w + 1) / 2) <= 0x1p-24);
    }
}

TEST_CASE("what lies inside is not touched, what lies beyond one plane is gone") {
    Random random(11);
    for (int i = 0; i < 2000; ++i) {
        glm::vec4 corners[3];
        for (glm::vec4& c : corners) {
            const float w = float(random.uniform(0.1, 50));
            c = glm::vec4(w * glm::vec3(random.in_box(0.99)), w);
        }
        std::vector<ScreenTriangle> out;
        clip_and_project(corners, 300, 200, 9, out);
        REQUIRE(out.size() == 1);
        CHECK(out[0].triangle == 9);
        for (int k = 0; k < 3; ++k) {
            const ScreenVertex expected = project(corners[k], 300, 200);
            CHECK((same_place(out[0].vertex[k], expected) && out[0].vertex[k].z == expected.z));
            CHECK(clip_code(corners[k], 300, 200) == 0);
        }
        const int axis = i % 3;
        const float side = i % 2 ? 1.0f : -1.0f;
        for (glm::vec4& c : corners)
            c[axis] = side * 200 * (std::abs(c.w) + 1);  // beyond the guard band (83 for 200 pixels) too
        out.clear();
        clip_and_project(corners, 300, 200, 9, out);
        CHECK(out.empty());
        CHECK((clip_code(corners[0], 300, 200) & clip_code(corners[1], 300, 200) & clip_code(corners[2], 300, 200)) !=
              0);
    }
    const float nan = std::nanf("");
    CHECK(clip_code({nan, 0, 0, 1}, 300, 200) == clip_not_finite);
    CHECK(clip_code({0, 0, 0, INFINITY}, 300, 200) == clip_not_finite);
    CHECK(clip_code({0, 0, -1, 1}, 300, 200) == 0);  // on the near plane: inside
    CHECK(clip_code({0, 0, -1.5f, 1}, 300, 200) == clip_near);
    CHECK(clip_code({0, 0, 1.5f, 1}, 300, 200) == clip_far);
    CHECK(clip_code({0, 0, 0, -1}, 300, 200) & clip_near);  // behind the eye
}

TEST_CASE("clipping keeps the visible area and the orientation") {
    Random random(12);
    int cut = 0, behind = 0, tight = 0, pieces_at_most = 0;
    for (int i = 0; i < 20000; ++i) {
        glm::vec4 corners[3];
        const double near = 0.05, far = 6;
        for (glm::vec4& c : corners) {
            // Perspective: w is the distance in front of the eye, z = ((f + n) w - 2 f n) / (f - n).
            const double w = random.uniform(-4, 8), spread = i % 4 == 0 ? 4000 : 8;
            c = glm::vec4(random.uniform(-spread, spread), random.uniform(-spread, spread),
                          ((far + near) * w - 2 * far * near) / (far - near), w);
        }
        std::vector<ScreenTriangle> pieces;
        clip_and_project(corners, 64, 48, 3, pieces);
        double error;
        const std::vector<glm::dvec2> truth = visible_polygon(corners, 64, 48, error);
        double sum = 0, turned = 0;
        for (const ScreenTriangle& piece : pieces) {
            CHECK(piece.triangle == 3);
            sum += area_of(piece);
            turned += area_of(truth) > 0 ? std::max(-area_of(piece), 0.0) : std::max(area_of(piece), 0.0);
            for (const ScreenVertex& v : piece.vertex) CHECK((v.z >= 0 && v.z <= 1));
        }
        // Moving the corners of a polygon by e changes its area by at most e times the perimeter (and e^2 per corner).
        const double tolerance = error * perimeter_of(truth) + 7 * error * error;
        tight += tolerance < 0.01 * std::abs(area_of(truth));
        CAPTURE(i, truth.size(), area_of(truth), sum);
        CHECK(std::abs(sum - area_of(truth)) <= tolerance);
        CHECK(turned <= tolerance);
        cut += pieces.size() > 1;
        behind += !pieces.empty() && std::min({corners[0].w, corners[1].w, corners[2].w}) < 0;
        pieces_at_most = std::max(pieces_at_most, int(pieces.size()));
        CHECK(pieces.size() <= 7);
    }
    CHECK(cut > 4000);
    CHECK(behind > 4000);
    CHECK(tight > 4000);
    CHECK(pieces_at_most >= 4);
}

TEST_CASE("neighbours are cut at the same points, whatever corner their triangle starts with") {
    Random random(13);
    for (int i = 0; i < 5000; ++i) {
        const auto corner = [&] {
            const double w = random.uniform(-4, 8);
            return glm::vec4(random.uniform(-800, 800), random.uniform(-800, 800), 1.02 * w - 0.1, w);
        };
        const glm::vec4 a = corner(), b = corner(), c = corner(), d = corner();
        const auto outline = [](glm::vec4 p, glm::vec4 q, glm::vec4 r) {
            const glm::vec4 corners[3] = {p, q, r};
            std::vector<ScreenTriangle> pieces;
            clip_and_project(corners, 64, 64, 0, pieces);
            std::vector<ScreenVertex> out;
            for (const ScreenTriangle& piece : pieces) out.insert(out.end(), piece.vertex, piece.vertex + 3);
            return out;
        };
        const std::vector<ScreenVertex> one = outline(a, b, c), two = outline(d, b, a), other = outline(c, a, b);
        // The points on the edge a b, as a triangle that is nothing but this edge has them: they must be in all outlines.
        const glm::vec4 edge[3] = {a, b, a};
        std::vector<ScreenTriangle> on_edge;
        clip_and_project(edge, 64, 64, 0, on_edge);
        const auto holds = [](const std::vector<ScreenVertex>& points, const ScreenVertex& p) {
            return std::any_of(points.begin(), points.end(),
                               [&](const ScreenVertex& q) { return same_place(p, q) && p.z == q.z; });
        };
        for (const ScreenTriangle& t : on_edge)
            for (const ScreenVertex& v : t.vertex) {
                CAPTURE(i);
                CHECK((one.empty() || holds(one, v)));
                CHECK((two.empty() || holds(two, v)));
                CHECK((other.empty() || holds(other, v)));
            }
    }
}

TEST_CASE("a floor that runs under and behind the eye is covered without gap or overlap") {
    Random random(14);
    for (int round = 0; round < 60; ++round) {
        CAPTURE(round);
        // A floor at y = 0, cut into a jittered grid; some cells are far larger than the distance to the eye.
        const double cell = round % 3 == 0 ? 0.37 : round % 3 == 1 ? 3.1 : 40, near = 0.05, far = 200;
        const int across = round % 3 == 0 ? 40 : 12;
        const double height = random.uniform(0.3, 2), pitch = random.uniform(-0.2, 0.9),
                     heading = random.uniform(0, 6.28), roll = random.uniform(-0.5, 0.5);
        const glm::dvec3 eye(random.uniform(-1, 1) * cell, height, random.uniform(-1, 1) * cell);
        const glm::dvec3 forward(std::cos(heading) * std::cos(pitch), -std::sin(pitch),
                                 std::sin(heading) * std::cos(pitch));
        const glm::dvec3 up(std::sin(roll), std::cos(roll), 0);
        const glm::dmat4 to_clip = glm::perspective(1.2, 1.0, near, far) * glm::lookAt(eye, eye + forward, up);
        const double half = cell * across / 2;
        std::vector<glm::vec4> points;
        for (int j = 0; j <= across; ++j)
            for (int i = 0; i <= across; ++i) {
                const bool border = i == 0 || j == 0 || i == across || j == across;
                const double dx = border ? 0 : random.uniform(-0.24, 0.24) * cell,
                             dz = border ? 0 : random.uniform(-0.24, 0.24) * cell;
                points.push_back(glm::vec4(to_clip * glm::dvec4(i * cell - half + dx, 0, j * cell - half + dz, 1)));
            }
        Coverage coverage;
        std::vector<ScreenTriangle> pieces;
        for (int j = 0; j < across; ++j)
            for (int i = 0; i < across; ++i) {
                const int a = j * (across + 1) + i, b = a + 1, c = a + across + 1, d = c + 1;
                for (const auto& t : {std::array{a, b, d}, std::array{a, d, c}}) {
                    const glm::vec4 corners[3] = {points[size_t(t[0])], points[size_t(t[1])], points[size_t(t[2])]};
                    pieces.clear();
                    clip_and_project(corners, tile_size, tile_size, 0, pieces);
                    for (const ScreenTriangle& piece : pieces) coverage.add(piece);
                }
            }
        int expected = 0, missed = 0, doubled = 0, spurious = 0;
        for (int y = 0; y < tile_size; ++y)
            for (int x = 0; x < tile_size; ++x) {
                // Where the pixel's ray meets the floor, and how sure that is: the borders of floor, near and far plane may
                // be moved by rounding, by well under 0.1 pixel or 1e-3 of a distance.
                const auto hits = [&](double px, double py, double margin) {
                    const glm::dvec4 q =
                        glm::inverse(to_clip) * glm::dvec4(2 * px / tile_size - 1, 2 * py / tile_size - 1, 0, 1);
                    const glm::dvec3 ray = glm::dvec3(q) / q.w - eye;
                    if (ray.y >= 0) return false;
                    const glm::dvec3 hit = eye + ray * (-eye.y / ray.y);
                    const double distance = glm::dot(hit - eye, glm::normalize(forward));
                    return distance > near * (1 + margin) && distance < far * (1 - margin) &&
                           std::abs(hit.x) < half * (1 - margin) && std::abs(hit.z) < half * (1 - margin);
                };
                bool surely = true, maybe = false;
                for (double dy : {-0.1, 0.0, 0.1})
                    for (double dx : {-0.1, 0.0, 0.1}) {
                        surely &= hits(x + 0.5 + dx, y + 0.5 + dy, 1e-3);
                        maybe |= hits(x + 0.5 + dx, y + 0.5 + dy, -1e-3);
                    }
                expected += surely;
                missed += surely && coverage.missed(x, y);
                doubled += surely && !coverage.missed(x, y) && !coverage.once(x, y);
                spurious += !maybe && !coverage.missed(x, y);
            }
        CHECK(expected > 100);
        CHECK(missed == 0);
        CHECK(doubled == 0);
        CHECK(spurious == 0);
    }
}

TEST_CASE("projected corners fit the fixed-point grid, however far the triangle reaches") {
    // The rasterizer's 32-bit edge functions hold for coordinates below 2^23, so for films of 16384 pixels the guard band must be
    // kept to the pixel, although a cut's error is relative to the corners that are cut off and is divided by the near plane's w.
    Random random(15);
    int drawn = 0;
    for (int i = 0; i < 50000; ++i) {
        const double reach = std::pow(10, random.uniform(0, 9)), near = std::pow(10, random.uniform(-4, 0)),
                     far = 1e4 * near;
        glm::vec4 corners[3];
        for (glm::vec4& c : corners) {
            const double w = random.uniform(-reach, reach);
            c = glm::vec4(random.uniform(-reach, reach), random.uniform(-reach, reach),
                          ((far + near) * w - 2 * far * near) / (far - near), w);
        }
        const int size = i % 2 ? 16384 : 64;
        std::vector<ScreenTriangle> pieces;
        clip_and_project(corners, size, size, 0, pieces);
        drawn += !pieces.empty();
        for (const ScreenTriangle& piece : pieces)
            for (const ScreenVertex& v : piece.vertex) {
                CAPTURE(i, reach, near, v.x, v.y);
                REQUIRE(std::abs(int64_t(v.x) - size * 128) <= (size / 2 + 8192) * 256 + 1024);
                REQUIRE(std::abs(int64_t(v.y) - size * 128) <= (size / 2 + 8192) * 256 + 1024);
                REQUIRE((v.z >= 0 && v.z <= 1));
            }
    }
    CHECK(drawn > 5000);
}

TEST_CASE("a floor far larger than the near distance has no holes") {
    // Corners up to 3e4 away, a near plane at 1e-3. Below 32768 float32 holds z and w of a corner to 2^-10 each, together less
    // than the 2e-3 by which z + w tells the near plane from the eye: the floor is there. But were cut points computed in
    // float32 as well, their w would be off by 3e4 x 2^-24 = 1.8e-3 more and could turn out negative.
    Random random(16);
    for (int round = 0; round < 1000; ++round) {
        const double heading = random.uniform(0, 6.28), pitch = random.uniform(0.2, 0.9),
                     turn = random.uniform(0, 6.28);
        const glm::dvec3 eye(0, 1, 0),
            forward(std::cos(heading) * std::cos(pitch), -std::sin(pitch), std::sin(heading) * std::cos(pitch));
        const glm::dmat4 to_clip =
            glm::perspective(0.3, 1.0, 1e-3, 1e3) * glm::lookAt(eye, eye + forward, glm::dvec3(0, 1, 0));
        // The view is 0.3 high and looks down by at least 0.2: every pixel sees the floor, at most 1 / tan(0.05) = 20 away.
        glm::vec4 points[4];
        for (int k = 0; k < 4; ++k) {
            const double angle = turn + glm::radians(90.0 * k), reach = random.uniform(1.6e4, 3e4);
            points[k] = glm::vec4(to_clip * glm::dvec4(reach * std::cos(angle), 0, reach * std::sin(angle), 1));
        }
        Coverage coverage;
        for (const auto& t : {std::array{0, 1, 2}, std::array{0, 2, 3}}) {
            const glm::vec4 corners[3] = {points[t[0]], points[t[1]], points[t[2]]};
            std::vector<ScreenTriangle> pieces;
            clip_and_project(corners, tile_size, tile_size, 0, pieces);
            for (const ScreenTriangle& piece : pieces) coverage.add(piece);
        }
        int missed = 0;
        for (int y = 0; y < tile_size; ++y)
            for (int x = 0; x < tile_size; ++x) missed += coverage.missed(x, y);
        CAPTURE(round, heading, pitch);
        CHECK(missed == 0);
    }
}
