#pragma once
// What several test files share: repeatable randomness, a folder for files, and coverage worked out exactly.

#include <shadelab/pipeline.hpp>

#include <unistd.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <random>
#include <stdexcept>
#include <string>

namespace shadelab::testing {

/// The same numbers on every machine: the distributions of <random> are not specified bit for bit.
class Random {
public:
    explicit Random(uint64_t seed) : engine_(seed) {}
    double uniform(double from = 0, double to = 1) { return from + (to - from) * double(engine_() >> 11) * 0x1p-53; }
    int64_t integer(int64_t from, int64_t to) {
        return from + int64_t(engine_() % uint64_t(to - from + 1));
    }  // both included
    glm::dvec3 in_box(double half) { return {uniform(-half, half), uniform(-half, half), uniform(-half, half)}; }
    glm::dvec3 direction() {
        for (;;) {
            const glm::dvec3 v = in_box(1);
            if (const double length = glm::length(v); length > 0.1 && length < 1) return v / length;
        }
    }

private:
    std::mt19937_64 engine_;
};

class TemporaryFolder {
public:
    TemporaryFolder() {
        std::string name = (std::filesystem::temp_directory_path() / "shadelab-tests-XXXXXX").string();
        if (!mkdtemp(name.data())) throw std::runtime_error("no temporary folder");
        path_ = name;
    }
    ~TemporaryFolder() {
        std::error_code ignored;
        std::filesystem::remove_all(path_, ignored);
    }
    TemporaryFolder(const TemporaryFolder&) = delete;
    std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
    std::filesystem::path write(const std::string& name, const std::string& text) const {
        std::ofstream(path_ / name, std::ios::binary) << text;
        return path_ / name;
    }

private:
    std::filesystem::path path_;
};

/// `text` with one part replaced, in its first occurrence.
inline std::string replaced(std::string text, const std::string& from, const std::string& to) {
    const size_t at = text.find(from);
    if (at == std::string::npos) throw std::logic_error("a test replaces what is not there: " + from);
    return text.replace(at, from.size(), to);
}

// What interface.toml declares, for scenes and plugins by hand.
inline constexpr int point = 0, directional = 1, spot = 2;
inline const std::vector<std::string> light_kinds = {"point", "directional", "spot"};
inline constexpr const char* columns_of_nxv[] = {"n.x", "n.y", "n.z", "x.x", "x.y", "x.z", "v.x", "v.y", "v.z"};

struct Point {
    int64_t x, y;
};

/// Twice the signed area of (a, b, c), positive when they run counter-clockwise. Exact.
inline __int128 cross(Point a, Point b, Point c) {
    return __int128(b.x - a.x) * (c.y - a.y) - __int128(c.x - a.x) * (b.y - a.y);
}

/// Whether the triangle covers the point, exactly. The tie rule in another guise than the rasterizer's: a point on an edge
/// belongs to the triangle that holds it after a step to the right by e and a step up by e^2, for an infinitely small e. (So a
/// left edge owns, a horizontal edge owns when the triangle lies above it, and of two neighbours exactly one owns.)
inline bool covers_exactly(const ScreenTriangle& t, Point p) {
    Point v[3];
    for (int k = 0; k < 3; ++k) v[k] = {t.vertex[k].x, t.vertex[k].y};
    const __int128 area = cross(v[0], v[1], v[2]);
    if (area == 0) return false;
    for (int k = 0; k < 3; ++k) {
        const Point a = v[k], b = v[(k + 1) % 3];
        const int sign = area > 0 ? 1 : -1;
        const __int128 value = sign * cross(a, b, p);
        const int64_t along_e = -sign * (b.y - a.y), along_e2 = sign * (b.x - a.x);
        const bool inside = value != 0 ? value > 0 : along_e != 0 ? along_e > 0 : along_e2 > 0;
        if (!inside) return false;
    }
    return true;
}

inline Point sample_at(glm::ivec2 pixel, glm::ivec2 sample) {
    return {int64_t(pixel.x) * 256 + sample.x, int64_t(pixel.y) * 256 + sample.y};
}

inline VisibilityTile empty_tile(int samples) {
    VisibilityTile tile;
    tile.depth.assign(size_t(samples) * tile_size * tile_size, 1.0f);
    tile.triangle.assign(size_t(samples) * tile_size * tile_size, no_triangle);
    return tile;
}

/// A mesh by hand, with one normal for all vertices.
inline Mesh mesh_of(const std::vector<glm::dvec3>& positions, const std::vector<uint32_t>& indices,
                    glm::vec3 normal = {0, 0, 1}) {
    Mesh mesh;
    for (glm::dvec3 p : positions) mesh.positions.push_back(glm::vec3(p));
    mesh.normals.assign(positions.size(), normal);
    mesh.indices = indices;
    return mesh;
}

}  // namespace shadelab::testing
