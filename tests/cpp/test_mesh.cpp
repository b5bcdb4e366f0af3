// OBJ files and the normals of their vertices.
#include "support.hpp"

#include <shadelab/error.hpp>

#include <catch2/catch.hpp>

#include <algorithm>
#include <map>
#include <set>

using namespace shadelab;
using namespace shadelab::testing;
using Catch::Matchers::Contains;

namespace {

Mesh load(const std::string& text, Normals mode = Normals::smooth) {
    const TemporaryFolder folder;
    return load_mesh(folder.write("mesh.obj", text), mode);
}

/// The one line of an error, with the folder's name cut off.
std::string error_of(const std::string& text, Normals mode = Normals::smooth) {
    const TemporaryFolder folder;
    const std::filesystem::path file = folder.write("mesh.obj", text);
    try {
        load_mesh(file, mode);
    } catch (const InputError& error) {
        const std::string message = error.what(), prefix = file.parent_path().string() + "/";
        CHECK(message.find('\n') == std::string::npos);
        REQUIRE(message.rfind(prefix, 0) == 0);
        return message.substr(prefix.size());
    }
    return "no error";
}

double area_of(const Mesh& mesh) {
    double sum = 0;
    for (size_t t = 0; t < mesh.triangle_count(); ++t) {
        const glm::dvec3 a = mesh.positions[mesh.indices[3 * t]], b = mesh.positions[mesh.indices[3 * t + 1]],
                         c = mesh.positions[mesh.indices[3 * t + 2]];
        sum += glm::length(glm::cross(b - a, c - a)) / 2;
    }
    return sum;
}

bool mentions(const Mesh& mesh, const std::string& text) {
    return std::any_of(mesh.notes.begin(), mesh.notes.end(),
                       [&](const std::string& note) { return note.find(text) != std::string::npos; });
}

std::string vertices(const std::vector<glm::dvec3>& points) {
    std::string out;
    for (glm::dvec3 p : points)
        out += "v " + std::to_string(p.x) + " " + std::to_string(p.y) + " " + std::to_string(p.z) + "\n";
    return out;
}

const std::string square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

/// A cube whose six faces are cut along one diagonal or the other, by the bits of `cuts`.
std::string cube(unsigned cuts) {
    std::string out;
    for (int i = 0; i < 8; ++i)
        out +=
            "v " + std::to_string(i & 1) + " " + std::to_string(i >> 1 & 1) + " " + std::to_string(i >> 2 & 1) + "\n";
    const int faces[6][4] = {{1, 3, 4, 2}, {5, 6, 8, 7}, {1, 2, 6, 5}, {3, 7, 8, 4}, {1, 5, 7, 3}, {2, 4, 8, 6}};
    for (int f = 0; f < 6; ++f) {
        const auto corner = [&](int k) { return " " + std::to_string(faces[f][(k + int(cuts >> f & 1)) % 4]); };
        out += "f" + corner(0) + corner(1) + corner(2) + "\nf" + corner(0) + corner(2) + corner(3) + "\n";
    }
    return out;
}

}  // namespace

TEST_CASE("angle weighting: a cube's corner normals point along its diagonals, however the faces are cut") {
    for (unsigned cuts = 0; cuts < 64; ++cuts) {
        const Mesh mesh = load(cube(cuts));
        REQUIRE(mesh.positions.size() == 8);
        REQUIRE(mesh.triangle_count() == 12);
        for (size_t i = 0; i < 8; ++i) {
            const glm::dvec3 expected = glm::normalize(glm::dvec3(mesh.positions[i]) - glm::dvec3(0.5));
            // Computed in double, rounded to float32 once: half a unit in the last place of numbers below 1, in each component.
            CHECK(glm::length(glm::dvec3(mesh.normals[i]) - expected) <= 2 * 0x1p-25);
        }
        CHECK(mesh.opposing_normals);  // diagonally across a face the normals' cosine is -1/3
    }
}

TEST_CASE("angle weighting: refining a face does not tilt the normal, unequal areas do not either") {
    // A roof of two faces that meet in the edge from vertex 1 to vertex 2; the right one is a hundred times larger, the left one
    // is cut into a fan of slivers at vertex 1. Its angle at vertex 1 stays a right one.
    std::string text = vertices({{0, 0, 0}, {0, 1, 0}, {100, 100, -100}, {100, 0, -100}});
    text += "f 1 4 3\nf 1 3 2\n";
    std::vector<glm::dvec3> fan;
    for (int i = 0; i < 40; ++i) {  // the point after the last is vertex 2
        const double angle = glm::radians(90.0) * i / 40;
        fan.push_back({-std::cos(angle) / std::sqrt(2), std::sin(angle), -std::cos(angle) / std::sqrt(2)});
    }
    text += vertices(fan);
    for (int i = 0; i < 40; ++i)
        text += "f 1 " + std::to_string(i == 39 ? 2 : 6 + i) + " " + std::to_string(5 + i) + "\n";
    const Mesh mesh = load(text);
    bool found = false;
    for (size_t i = 0; i < mesh.positions.size(); ++i)
        if (mesh.positions[i] == glm::vec3(0)) {
            found = true;
            // Both faces span a right angle, so the normal halves their normals (1, 0, 1) and (-1, 0, 1); the file's six decimals
            // tilt the slivers' normals, each spanning 1/40 of the angle, by up to 1e-6 / (1/25).
            CHECK(glm::length(glm::dvec3(mesh.normals[i]) - glm::dvec3(0, 0, 1)) < 2 * 0.5e-6 * 25);
        }
    CHECK(found);
}

TEST_CASE("normals of a random mesh: unit, and the same after moving it far away") {
    Random random(30);
    std::vector<glm::dvec3> points, moved;
    std::string faces;
    for (int i = 0; i < 60; ++i) {
        const glm::dvec3 p = random.in_box(1);
        points.push_back(glm::round(p * 4096.0) / 4096.0);
        moved.push_back(points.back() + glm::dvec3(1048576, -2097152, 1048576));  // sums are exact in double
    }
    for (int i = 0; i < 100; ++i) {
        int a = int(random.integer(1, 60)), b = int(random.integer(1, 60)), c = int(random.integer(1, 60));
        if (a == b || b == c || a == c) continue;
        faces += "f " + std::to_string(a) + " " + std::to_string(b) + " " + std::to_string(c) + "\n";
    }
    const auto exact = [](const std::vector<glm::dvec3>& list) {
        std::string out;
        char line[200];
        for (glm::dvec3 p : list) {
            std::snprintf(line, sizeof line, "v %.12f %.12f %.12f\n", p.x, p.y, p.z);
            out += line;
        }
        return out;
    };
    for (Normals mode : {Normals::smooth, Normals::flat}) {
        const Mesh here = load(exact(points) + faces, mode), there = load(exact(moved) + faces, mode);
        REQUIRE(here.normals.size() == there.normals.size());
        for (size_t i = 0; i < here.normals.size(); ++i) {
            CHECK(std::abs(glm::length(glm::dvec3(here.normals[i])) - 1) <= 2 * 0x1p-24);
            // The file's numbers, read as 2e6 + x, hold x to 2^-32 (the reader rounds a few times): 1e-9 against edges of 1/10
            // and more; computed in float32 they would be off by tenths.
            CHECK(glm::length(here.normals[i] - there.normals[i]) < 1e-5);
        }
    }
}

TEST_CASE("large coordinates: the origin is subtracted in double, before anything is rounded") {
    // A bumpy sheet of 8 x 8 quads, about 2 wide.
    std::vector<glm::dvec3> points;
    std::string faces;
    Random random(31);
    for (int i = 0; i <= 8; ++i)
        for (int j = 0; j <= 8; ++j) points.push_back(glm::dvec3(i / 4.0 - 1, j / 4.0 - 1, 0) + random.in_box(0.05));
    for (int i = 0; i < 8; ++i)
        for (int j = 0; j < 8; ++j) {
            const int a = 9 * i + j + 1;
            const auto n = [](int corner) { return " " + std::to_string(corner); };
            faces += "f" + n(a) + n(a + 9) + n(a + 10) + "\nf" + n(a) + n(a + 10) + n(a + 1) + "\n";
        }
    const auto moved = [&](glm::dvec3 by, Normals mode) {
        std::string out;
        char line[200];
        for (glm::dvec3 p : points) {
            std::snprintf(line, sizeof line, "v %.17g %.17g %.17g\n", p.x + by.x, p.y + by.y, p.z + by.z);
            out += line;
        }
        return load(out + faces, mode);
    };
    for (Normals mode : {Normals::smooth, Normals::flat}) {
        const Mesh here = moved(glm::dvec3(0), mode), near = moved(glm::dvec3(20, -20, 20), mode);
        CHECK(here.origin == glm::dvec3(0));
        CHECK(near.origin == glm::dvec3(0));  // 35 away, 2.9 large: the file's own coordinates, rounded
        for (const glm::dvec3 by : {glm::dvec3(1e6, -2e6, 1e6), glm::dvec3(0, 0, 1e8), glm::dvec3(1e8)}) {
            const Mesh there = moved(by, mode);
            CHECK(glm::length(there.origin - by) < 0.2);  // the middle of the sheet
            REQUIRE(there.indices == here.indices);
            // The file's sums are rounded to double; then, as all positions below 2, to float32.
            const double in_file = glm::length(by) * 0x1p-53, in_float = 2 * 0x1p-24;
            for (size_t i = 0; i < here.positions.size(); ++i) {
                const glm::dvec3 p = there.origin + glm::dvec3(there.positions[i]) - by;
                const glm::dvec3 off = glm::abs(p - glm::dvec3(here.positions[i]));
                CHECK(std::max({off.x, off.y, off.z}) <= 4 * in_file + 2 * in_float);
                // Edges are 0.15 and longer: the digits that the file has no room for turn them by so much.
                CHECK(glm::length(here.normals[i] - there.normals[i]) < 20 * in_file + 4 * in_float);
                CHECK(glm::length(here.normals[i] - there.normals[i]) < 1e-6);
            }
        }
    }
}

TEST_CASE("flat normals are the faces', right-handed") {
    const Mesh mesh = load(square + "v 0 0 1\nf 1 2 3 4\nf 1 5 2\n", Normals::flat);
    CHECK(mesh.triangle_count() == 3);
    CHECK(mesh.positions.size() == 9);
    std::map<uint32_t, int> used;
    for (uint32_t i : mesh.indices) ++used[i];
    CHECK(used.size() == 9);
    for (int k = 0; k < 6; ++k) CHECK(mesh.normals[mesh.indices[size_t(k)]] == glm::vec3(0, 0, 1));
    for (int k = 6; k < 9; ++k) CHECK(mesh.normals[mesh.indices[size_t(k)]] == glm::vec3(0, 1, 0));
    CHECK_FALSE(mesh.opposing_normals);
}

TEST_CASE("vertex normals that cancel become the faces', and are counted") {
    // A sheet with a front and a back: every vertex has two opposite faces.
    const Mesh sheet = load("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 3 2\n");
    CHECK(sheet.cancelled_normals == 3);
    CHECK(mentions(sheet, "3 vertices whose face normals cancel"));
    REQUIRE(sheet.positions.size() == 6);
    for (int k = 0; k < 3; ++k) {
        CHECK(sheet.normals[sheet.indices[size_t(k)]] == glm::vec3(0, 0, 1));
        CHECK(sheet.normals[sheet.indices[size_t(3 + k)]] == glm::vec3(0, 0, -1));
    }
    CHECK_FALSE(sheet.opposing_normals);
    // Only where they cancel: the sheet's free corner shares its point with a third face.
    const Mesh three = load("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv -1 0 1\nf 1 2 3\nf 1 3 2\nf 1 4 5\n");
    CHECK(three.cancelled_normals == 2);
    for (glm::vec3 n : three.normals) CHECK(std::abs(glm::length(n) - 1) < 1e-6f);
}

TEST_CASE("triangles whose vertex normals oppose are noticed") {
    // The fin of a narrow wedge: the two sides' normals at the ridge average, those at the open ends oppose within one triangle
    // only when it reaches from the one to the other, as the end cap here does.
    const Mesh tetrahedron = load("v 0 0 0\nv 1 0 0\nv 0.5 1 0\nv 0.5 0.4 0.001\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n");
    CHECK(tetrahedron.opposing_normals);
    const Mesh from_file = load(square + "vn 0 0 1\nvn 0 1 -0.1\nf 1//1 2//1 3//2\n", Normals::file);
    CHECK(from_file.opposing_normals);
    CHECK_FALSE(load(square + "vn 0 0 1\nvn 0 1 0.1\nf 1//1 2//1 3//2\n", Normals::file).opposing_normals);
}

TEST_CASE("polygons, also concave ones, are cut into triangles of the same area and orientation") {
    // An L of area 3 and an arrow; the loader may choose the diagonals, not the shape.
    const Mesh l = load("v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\nf 1 2 3 4 5 6\n");
    CHECK(l.triangle_count() == 4);
    CHECK(area_of(l) == Approx(3).epsilon(1e-12));
    const Mesh arrow = load("v 0 0 0\nv 2 1 0\nv 0 2 0\nv 0.5 1 0\nv 9 9 9\nf 1 2 3 4\n");
    CHECK(arrow.triangle_count() == 2);
    for (const Mesh* mesh : {&l, &arrow})
        for (glm::vec3 n : mesh->normals) CHECK(n == glm::vec3(0, 0, 1));
    CHECK(arrow.positions.size() == 4);  // what no face uses is not there
    CHECK(load(square + "f 1 2 3 4\n").positions.size() == 4);

    const struct {
        std::vector<glm::dvec3> corners;
        double area;
        size_t triangles;
    } examples[] = {
        {{{0, 0, 0}, {2, -0.1, 0}, {4, 0, 0}, {2, 3, 0}, {0.1, 3, 0}}, 9.05, 3},  // convex
        {{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {2, 1, 0}, {0, 1, 0}}, 2, 3},          // a corner on an edge
        {{{-0.5, 0, 0}, {0, 1, 0}, {0.5, 0, 0}, {0, 4, 0}}, 1.5, 2},              // shorter diagonal outside
        {{{0, 1, 0}, {0.5, 0, 0}, {0, 4, 0}, {-0.5, 0, 0}}, 1.5, 2},              // the same from there on
        {{{1, 1, 0}, {0, 2, 0}, {0, 0, 0}, {2, 0, 0}, {2, 2, 0}}, 3, 3},          // concave first corner
        {{{0, 0, 0}, {3, 0, 0}, {3, 3, 0}, {0, 3, 0}, {0, 0, 0}, {1, 1, 0}, {1, 2, 0}, {2, 2, 0}, {2, 1, 0}, {1, 1, 0}},
         8,
         8},  // a hole, with a bridge to it
    };
    for (const auto& example : examples)
        for (int turn = 0; turn < 3; ++turn) {  // in three planes
            std::string text, face = "f";
            for (glm::dvec3 p : example.corners) {
                text += vertices({turn == 0 ? p : turn == 1 ? glm::dvec3(p.z, p.x, p.y) : glm::dvec3(p.y, p.z, p.x)});
                face += " " + std::to_string(std::count(text.begin(), text.end(), '\n'));
            }
            const Mesh mesh = load(text + face + "\n", Normals::flat);
            CAPTURE(face, turn);
            CHECK(mesh.triangle_count() == example.triangles);
            CHECK(area_of(mesh) == Approx(example.area).epsilon(1e-6));
            for (glm::vec3 n : mesh.normals) CHECK(n[(2 + turn) % 3] == 1);
        }
    // Without area or finite coordinates there is no shape to cut: counted, not drawn.
    CHECK(load(square + "f 1 2 1 2 1\nf 1 2 3\n").dropped_triangles == 3);
    CHECK(load(square + "v nan 0 0\nf 5 1 2 3 4\nf 1 2 3\n").dropped_triangles == 3);
}

namespace {

/// A polygon in the plane z = 0, tilted by `tilt`, as a file with one face.
std::string polygon(const std::vector<glm::dvec2>& outline, const glm::dmat3& tilt = glm::dmat3(1)) {
    std::string face = "f";
    std::vector<glm::dvec3> points;
    for (glm::dvec2 p : outline) {
        points.push_back(tilt * glm::dvec3(p, 0));
        face += " " + std::to_string(points.size());
    }
    return vertices(points) + face + "\n";
}

double signed_area(const std::vector<glm::dvec2>& outline) {
    double sum = 0;
    for (size_t i = 0; i < outline.size(); ++i) {
        const glm::dvec2 a = outline[i], b = outline[(i + 1) % outline.size()];
        sum += (a.x * b.y - a.y * b.x) / 2;
    }
    return sum;
}

/// Of all triangles, how many hold the point. Points on an edge do not occur.
int covering(const Mesh& mesh, glm::dvec2 p, const glm::dmat3& tilt) {
    int count = 0;
    for (size_t t = 0; t < mesh.triangle_count(); ++t) {
        glm::dvec2 corner[3];
        for (size_t k = 0; k < 3; ++k)
            corner[k] = glm::transpose(tilt) * glm::dvec3(mesh.positions[mesh.indices[3 * t + k]]) + 1e-9;
        bool inside = true;
        for (int k = 0; k < 3; ++k) {
            const glm::dvec2 edge = corner[(k + 1) % 3] - corner[k], to = p - corner[k];
            inside &= edge.x * to.y - edge.y * to.x > 0;
        }
        count += inside;
    }
    return count;
}

bool holds(const std::vector<glm::dvec2>& outline, glm::dvec2 p) {
    bool in = false;
    for (size_t i = 0; i < outline.size(); ++i) {
        const glm::dvec2 a = outline[i], b = outline[(i + 1) % outline.size()];
        if ((a.y > p.y) != (b.y > p.y) && p.x < a.x + (b.x - a.x) * (p.y - a.y) / (b.y - a.y)) in = !in;
    }
    return in;
}

}  // namespace

TEST_CASE("polygons that touch themselves are covered once, and nothing beyond them is") {
    const std::vector<std::vector<glm::dvec2>> outlines = {
        // two triangles that meet in a corner; a corner that touches an edge; a spike; a corner said twice; corners in a line
        {{0, 0}, {2, 0}, {1, 1}, {2, 2}, {0, 2}, {1, 1}},
        {{0, 0}, {4, 0}, {4, 4}, {2, 0}, {0, 4}},
        {{0, 0}, {4, 0}, {6, 0}, {4, 0}, {4, 4}, {0, 4}},
        {{0, 0}, {4, 0}, {4, 0}, {4, 4}, {0, 4}},
        {{0, 0}, {1, 0}, {2, 0}, {4, 0}, {4, 4}, {2, 4}, {0, 4}, {0, 2}},
        // a hole, joined to the rim by an edge that is gone there and back; two such holes
        {{0, 0}, {6, 0}, {6, 6}, {0, 6}, {0, 0}, {2, 2}, {2, 4}, {4, 4}, {4, 2}, {2, 2}},
        {{0, 0},
         {9, 0},
         {9, 6},
         {0, 6},
         {0, 0},
         {1, 1},
         {1, 5},
         {4, 5},
         {4, 1},
         {5, 1},
         {5, 5},
         {8, 5},
         {8, 1},
         {5, 1},
         {4, 1},
         {1, 1}},
        // a hole that touches the rim in one corner; one that touches an edge
        {{0, 0}, {8, 0}, {8, 8}, {0, 8}, {0, 0}, {2, 5}, {5, 2}},
        {{0, 0}, {8, 0}, {8, 8}, {0, 8}, {0, 4}, {4, 6}, {4, 2}, {0, 4}},
        // three petals round one corner, and round two
        {{0, 0}, {3, -1}, {3, 1}, {0, 0}, {1, 3}, {-1, 3}, {0, 0}, {-3, -1}, {-1, -3}},
        {{0, 0}, {2, -1}, {4, 0}, {6, -2}, {6, 2}, {4, 0}, {2, 1}, {0, 0}, {-2, 2}, {-2, -2}},
        // a quad whose corner lies on its shorter diagonal
        {{0, 0}, {4, -1}, {2, 0}, {4, 9}},
        {{0, 0}, {3, -3}, {4, 0}, {2, 0}},
    };
    const glm::dmat3 straight(1),
        tilted = glm::dmat3(glm::dvec3(0.6, 0, 0.8), glm::dvec3(-0.64, 0.6, 0.48), glm::dvec3(-0.48, -0.8, 0.36));
    for (size_t number = 0; number < outlines.size(); ++number)
        for (size_t start = 0; start < outlines[number].size(); ++start)
            for (int reversed = 0; reversed < 2; ++reversed)
                for (const glm::dmat3& tilt : {straight, tilted}) {
                    std::vector<glm::dvec2> outline = outlines[number];
                    std::rotate(outline.begin(), outline.begin() + long(start), outline.end());
                    if (reversed) std::reverse(outline.begin(), outline.end());
                    CAPTURE(number, start, reversed);
                    const Mesh mesh = load(polygon(outline, tilt));
                    CHECK(area_of(mesh) == Approx(std::abs(signed_area(outline))));
                    CHECK_FALSE(mentions(mesh, "crosses itself"));
                    int wrong = 0;
                    for (double x = -2.97; x < 9.5; x += 0.2411)
                        for (double y = -3.93; y < 9.5; y += 0.2537) {
                            const glm::dvec2 p(x, y);
                            const int expected = holds(outline, p) ? 1 : 0;
                            // seen from the side on which its corners go round counterclockwise
                            const int covered = signed_area(outline) > 0 ? covering(mesh, p, tilt) : -1;
                            wrong += covered >= 0 && covered != expected;
                        }
                    CHECK(wrong == 0);
                }
}

TEST_CASE("a polygon that crosses itself is drawn with a note that names its line") {
    for (const std::vector<glm::dvec2>& outline : std::vector<std::vector<glm::dvec2>>{
             {{0, 0}, {1, 1}, {1, 0}, {0, 1}},                                      // a bow tie
             {{0, 1}, {0.59, -0.81}, {-0.95, 0.31}, {0.95, 0.31}, {-0.59, -0.81}},  // a pentagram
             {{0, 0}, {2, 2}, {4, 0}, {4, 2}, {2, 0}, {0, 2}},                      // no area in sum
         }) {
        const Mesh mesh = load("# a comment\n" + polygon(outline));
        CHECK(mesh.triangle_count() > 0);
        CHECK(mentions(mesh, "line " + std::to_string(outline.size() + 2) + ": this polygon crosses itself"));
    }
    CHECK(mentions(load(polygon({{0, 0}, {1, 1}, {1, 0}, {0, 1}}) + "f 1 2 3 4\n"), "the first of 2;"));
}

TEST_CASE("negative indices, groups, comments, texture coordinates and Windows line ends mean the same mesh") {
    const Mesh plain = load(square + "f 1 2 3\nf 1 3 4\n");
    const auto same = [&](const Mesh& mesh) {
        return mesh.positions == plain.positions && mesh.normals == plain.normals && mesh.indices == plain.indices;
    };
    CHECK(same(load(square + "f -4 -3 -2\nf -4 -2 -1\n")));
    CHECK(same(load("v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 0 1 0\nf -4 -2 -1\n")));
    CHECK(same(load("# a comment\n" + square +
                    "g first\nf 1 2 3\n\n  # here as well\no other\ng second third\ns 1\nf 1 3 4")));
    CHECK(same(load(square + "vt 0 0\nvt 1 1\nf 1/1 2/2 3/1\nf 1/1 3/2 4/2\n")));
    CHECK(same(load(
        square + "vn 0 1 0\nf 1//1 2//1 3//1\nf 1//1 3//1 4//1\n")));  // smooth: the file's normals are not asked for
    std::string windows = square + "g a\nf 1 2 3\nf 1 3 4\n";
    std::string old_mac = windows;
    for (size_t at = 0; (at = windows.find('\n', at)) != std::string::npos; at += 2) windows.replace(at, 1, "\r\n");
    CHECK(same(load(windows)));
    std::replace(old_mac.begin(), old_mac.end(), '\n', '\r');
    CHECK(same(load(old_mac)));
    CHECK(plain.notes.empty());
    const std::string corners[] = {"1/2/1 2/1/1 3/2/1", "1//-1 2//-1 3//-1", "1/1 -3/1 3/1", "\t1\t 2  3 \t",
                                   "1 2 3# 9"};
    for (const std::string& first : corners)
        CHECK(same(load(square + "vt 0 0\nvt 1 1\nvn 0 0 1\n\tf " + first + "\nf 1 3 4 # the other half")));
}

TEST_CASE("a vertex: three numbers in any notation, perhaps a weight or a colour, perhaps a comment") {
    const Mesh mesh = load("v +1 -0 1e0 1.0\nv 0.25e+1\t2.5E-1 .5 1 0.5 0.25\n  v -2. 1e-400 3 # text\nf 1 2 3");
    REQUIRE(mesh.positions.size() == 3);
    CHECK(mesh.positions[0] == glm::vec3(1, 0, 1));
    CHECK(mesh.positions[1] == glm::vec3(2.5, 0.25, 0.5));
    CHECK(mesh.positions[2] == glm::vec3(-2, 0, 3));
    // Read to the last bit, which decides how a float32 is rounded: 1 + 2^-24 lies midway between two.
    const Mesh midway =
        load("v 1.000000059604644775390625 1.0000000596046448 1.0000000596046449\nv 0 0 0\nv 0 1 0\nf 1 2 3");
    CHECK(midway.positions[0] == glm::vec3(1, 1, 1 + 0x1p-23f));
}

TEST_CASE("material libraries are ignored with a note, and not looked for") {
    const Mesh mesh = load("mtllib nowhere.mtl\n" + square + "usemtl brass\nf 1 2 3 4\n");
    CHECK(mesh.triangle_count() == 2);
    REQUIRE(mesh.notes.size() == 1);
    CHECK_THAT(mesh.notes[0], Contains("mesh.obj") && Contains("mtllib") && Contains("ignored"));
}

TEST_CASE("normals from the file: per corner, made unit; smooth ones with a note where there are none") {
    const std::string normals = "vn 0 0 5\nvn 3 0 4\n";
    const Mesh mesh = load(square + normals + "f 1//1 2//2 3//1\nf 1//1 3//2 4//1\n", Normals::file);
    CHECK(mesh.positions.size() == 5);  // vertex 3 stands there twice, with a normal each
    CHECK(mesh.notes.empty());
    CHECK(mesh.normals[mesh.indices[0]] == glm::vec3(0, 0, 1));
    CHECK(glm::length(mesh.normals[mesh.indices[1]] - glm::vec3(0.6f, 0, 0.8f)) < 1e-6f);
    CHECK(mesh.positions[mesh.indices[2]] == mesh.positions[mesh.indices[4]]);
    CHECK(mesh.normals[mesh.indices[2]] != mesh.normals[mesh.indices[4]]);
    for (const char* faces : {"f 1 2 3\nf 1 3 4\n", "f 1//1 2//1 3//1\nf 1 3 4\n"}) {
        const Mesh smooth = load(square + normals + faces, Normals::file);
        CHECK(mentions(smooth, "normals = \"file\""));
        for (glm::vec3 n : smooth.normals) CHECK(n == glm::vec3(0, 0, 1));
    }
}

TEST_CASE("a normal of the file that is no direction costs its own corners alone, and is told with its line") {
    const std::string normals = "vn 0 0 5\nvn 3 0 4\n";
    for (const char* bad :
         {"0 0 0", "nan 0 1", "0 0 inf", "-1.#IND00 -1.#IND00 -1.#IND00", "1.#QNAN 0 1", "0 1.#INF 0"}) {
        CAPTURE(bad);
        const Mesh mesh = load(square + normals + "vn " + bad + "\nf 1//3 2//2 3//2\n", Normals::file);
        REQUIRE(mesh.notes.size() == 1);
        CHECK_THAT(mesh.notes[0], Contains("line 7: a normal that is no direction"));
        CHECK(mesh.normals[mesh.indices[0]] == glm::vec3(0, 0, 1));  // as the face
        for (int k : {1, 2}) CHECK(glm::length(mesh.normals[mesh.indices[k]] - glm::vec3(0.6f, 0, 0.8f)) < 1e-6f);
        CHECK(load(square + "vn " + bad + "\nf 1//1 2//1 3//1\n", Normals::flat).notes.empty());
    }
}

TEST_CASE(
    "corners may end in a slash, lines may go on, a file may begin with a mark, and lack the normals that it names") {
    const Mesh plain = load(square + "f 1 2 3 4\n");
    const auto same = [&](const Mesh& mesh) {
        return mesh.positions == plain.positions && mesh.normals == plain.normals && mesh.indices == plain.indices;
    };
    for (const char* face :
         {"f 1/ 2/ 3/ 4/", "f 1// 2// 3// 4//", "vt 0 0\nf 1/1/ 2/1/ 3/1/ 4/1/", "f 1//1 2//1 3//1 4//1",
          "f 1 2 \\\n3 4", "f 1 2\\\r\n 3 4", "f \\\n\\\n1 2 3 4", "g a \\\nv 9 9 9\nf 1 2 3 4",
          "usemtl a\\b\\c d\nf 1 2 3 4", "# a comment does not go on \\\nf 1 2 3 4"}) {
        CAPTURE(face);
        const Mesh mesh = load(square + face + "\n");
        CHECK((same(mesh) && mesh.notes.empty()));
    }
    CHECK(same(load("\xef\xbb\xbf" + square + "f 1 2 3 4\n")));
    CHECK_THAT(error_of(square + "f 1 2 \\\n3 9\n"), Contains("vertex 9"));
    CHECK_THAT(error_of(square + "f 1 2 \\\n3 4\nf 1 2 9\n"),
               Contains("mesh.obj:7: "));  // lines are counted all the same
}

TEST_CASE("a line that begins with an unknown word is ignored with a note, and so are smoothing groups") {
    const Mesh mesh = load(square + "V 1 1 1\n\fv 2 2 2\nf 1 2 3 4\n");
    CHECK(mesh.triangle_count() == 2);
    REQUIRE(mesh.notes.size() == 1);
    CHECK_THAT(mesh.notes[0], Contains("line 5: \"V\" begins no line of an OBJ file; 2 such lines are ignored"));
    CHECK(mentions(load(square + "\x1bv 1\nf 1 2 3 4\n"), "line 5: \"?v\""));
    CHECK(load(square + "s off\ns 1\nvt 1 1\nvp 1\nl 1 2\no a\nf 1 2 3 4\n").notes.empty());
    const std::string groups = square + "s 1\nf 1 2 3\ns 2\nf 1 3 4\n";
    CHECK(mentions(load(groups), "2 smoothing groups (s) are ignored"));
    CHECK(load(groups, Normals::flat).notes.empty());
}

TEST_CASE("an index that is not there is an error with file and line") {
    const std::string file = square + "vn 0 0 1\n";  // five lines
    CHECK(error_of(file + "f 1 2 3\nf 1 2 7\n") == "mesh.obj:7: the face refers to vertex 7, but the file has 4");
    CHECK(error_of(file + "f 1 2 7 3\n") == "mesh.obj:6: the face refers to vertex 7, but the file has 4");
    CHECK(error_of(file + "f 1 2 3 4 1000000\n") ==
          "mesh.obj:6: the face refers to vertex 1000000, but the file has 4");
    CHECK(error_of(file + "\n# text\nf 1 2 -5\n") == "mesh.obj:8: the face refers to vertex -5, but the file has 4");
    CHECK(error_of("f 1 2 -1\n" + file) ==
          "mesh.obj:1: the face refers to vertex -1, but the file has 4");  // none stands above it
    CHECK(error_of(file + "g a\nf 1//1 2//1 3//2\n", Normals::file) ==
          "mesh.obj:7: the face refers to normal 2, but the file has 1");
    CHECK(error_of(file + "f 1//1 2//1 3//-2\n") == "mesh.obj:6: the face refers to normal -2, but the file has 1");
    CHECK_THAT(error_of(file + "f 0 1 2\n"),
               Contains("mesh.obj:6: ") && Contains("vertex 0") && Contains("counted from 1"));
    CHECK(error_of(file + "f 1 two 3\n") == "mesh.obj:6: \"two\" is not a corner: v, v/t, v//n or v/t/n");
    for (const char* corner : {"1/1/1/1", "1/x", "/1", "1.5", "1a", "99999999999", "\\", "1//x"})
        CHECK(error_of(file + "f 2 " + corner + " 3\n") ==
              "mesh.obj:6: \"" + std::string(corner) + "\" is not a corner: v, v/t, v//n or v/t/n");
    CHECK_THAT(error_of(file + "f 1//0 2//1 3//1\n"), Contains("mesh.obj:6: the face refers to normal 0"));
    CHECK_THAT(error_of(square + "v 1 x 2\nf 1 2 3\n"), Contains("mesh.obj:5: a vertex takes three numbers"));
    for (const char* vertex :
         {"v 1 2", "v", "v 1 2 # 3", "v 1,2,3", "v 1 2 3x", "v 1 2 \\ 3", "v 0x10 0 0", "v 1 2 1e"})
        CHECK(error_of(square + vertex + "\nf 1 2 3\n") == "mesh.obj:5: a vertex takes three numbers");
    CHECK(error_of(square + "vn 0 1\nf 1 2 3\n") == "mesh.obj:5: a normal takes three numbers");
    CHECK(error_of(file + "f 1 2 3\r\nf 1 2 7\r\n") == "mesh.obj:7: the face refers to vertex 7, but the file has 4");
}

TEST_CASE("triangles without area or with vertices that are not finite are counted and left out") {
    const std::string more = square + "v nan 0 0\nv 0 inf 0\nv 0 1e999 0\nv 0.5 0 0\n";
    const struct {
        const char* faces;
        int dropped;
    } examples[] = {{"f 1 1 2\n", 1},
                    {"f 1 2 8\n", 1},
                    {"f 1 2 5\nf 6 2 3\nf 2 1 7\n", 3},
                    {"f 1 2\n", 1},
                    {"f 2 2 2\nf 3 3 1\n", 2}};
    for (const auto& example : examples) {
        CAPTURE(example.faces);
        const Mesh mesh = load(more + "f 1 3 4\n" + example.faces + "f 1 2 3\n");
        CHECK(mesh.dropped_triangles == example.dropped);
        CHECK(mesh.triangle_count() == 2);
        CHECK(mentions(mesh, std::to_string(example.dropped) + " triangles without area"));
        for (glm::vec3 p : mesh.positions) CHECK((p.z == 0 && std::isfinite(p.x) && std::isfinite(p.y)));
        // They do not weigh on their neighbours' normals either.
        for (glm::vec3 n : mesh.normals) CHECK(n == glm::vec3(0, 0, 1));
    }
    // A sliver has an area, if a small one, and a normal.
    const Mesh sliver = load("v 0 0 0\nv 1 0 0\nv 0.5 1e-30 0\nf 1 2 3\n");
    CHECK(sliver.dropped_triangles == 0);
    REQUIRE(sliver.normals.size() == 3);
    for (glm::vec3 n : sliver.normals) CHECK(n == glm::vec3(0, 0, 1));
}

TEST_CASE("a file without faces or a missing file is an error that says so") {
    CHECK(error_of("") == "mesh.obj: holds no faces");
    CHECK(error_of(square) == "mesh.obj: holds no faces");
    CHECK(error_of("this is no mesh\n") == "mesh.obj: holds no faces");
    const TemporaryFolder folder;
    for (const std::filesystem::path& path : {folder / "absent.obj", folder / "."}) {
        CHECK_THROWS_WITH(
            load_mesh(path, Normals::smooth, "scene.toml:7: object[0].mesh"),
            Catch::Matchers::StartsWith("scene.toml:7: object[0].mesh: the mesh " + path.string() + " cannot be read"));
        CHECK_THROWS_AS(load_mesh(path, Normals::smooth), InputError);
    }
}
