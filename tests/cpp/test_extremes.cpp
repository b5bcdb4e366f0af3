// Hard cases for draw(), each against double or exact integer arithmetic: what passes the eye, what reaches far beyond the film,
// what is smaller than a pixel, thin, degenerate, not finite, far from the origin, or seen from behind.
#include "support.hpp"

#include <catch2/catch.hpp>

#include <glm/gtc/matrix_transform.hpp>

#include <algorithm>
#include <array>
#include <cstring>

using namespace shadelab;
using namespace shadelab::testing;

namespace {

constexpr double ulp = 0x1p-24;  // of numbers from 1/2 to 1: what depth and unit vectors are rounded to, twice over

// -------------------------------------------------------------------------------- a white surface, and scenes by hand

template <class Real>
void white(const plugin::Batch<Real>& batch, const Real*, const Real*) {
    for (int k = 0; k < 12; ++k)
        for (int i = 0; i < batch.count; ++i) batch.out[k][i] += k < 3 ? Real(1) : Real(1) / 3;
}

Scene scene_with(int width, int height, int objects = 1) {
    Scene scene;
    scene.film.width = width;
    scene.film.height = height;
    scene.camera = {{0, 0, 3}, {0, 0, 0}, {0, 1, 0}, glm::radians(50.0), 0.1, 100};
    Light light{};
    light.kind = directional;
    light.placed = false;
    light.intensity = glm::dvec3(1);
    scene.lights = {light};
    scene.materials = {{"plain", "white", {}}};
    for (int i = 0; i < objects; ++i) {
        Object object;
        object.material = 0;
        scene.objects.push_back(object);
    }
    return scene;
}

struct Drawn {
    Film film;
    DrawStatistics statistics;

    const float* pixel(const char* layer, int x, int y) const {
        return film.find(layer)->pixel(size_t(y) * film.width + x);
    }  // y from the top
    float value(const char* layer, int x, int y) const { return *pixel(layer, x, y); }
    glm::dvec3 vector(const char* layer, int x, int y) const {
        const float* p = pixel(layer, x, y);
        return {p[0], p[1], p[2]};
    }
    bool covered(int x, int y) const { return value("id", x, y) != 0; }
};

template <class Real = float>
Drawn draw_scene(const Scene& scene, const std::vector<Mesh>& meshes) {
    Features features;
    features.term_layers = features.geometry_layers = true;
    features.per_fragment = features.gouraud = true;
    features.lights = {0};
    features.materials = {0};
    const plugin::Shade<Real> loops[] = {white<Real>, white<Real>, white<Real>};
    const plugin::Model<Real> model{"white", 0, nullptr, loops};
    const plugin::Table<Real> table{plugin::abi_version, sizeof(Real), true, 3, 1, 0, &model, nullptr};
    Drawn out{Film(scene.film.width, scene.film.height, features, scene.film.background), {}};
    out.statistics = draw<Real>(scene, features, meshes, table, out.film);
    return out;
}

bool identical(const Film& a, const Film& b) {
    bool same = a.layers.size() == b.layers.size();
    for (size_t l = 0; same && l < a.layers.size(); ++l)
        same = a.layers[l].data.size() == b.layers[l].data.size() &&
               std::memcmp(a.layers[l].data.data(), b.layers[l].data.data(), a.layers[l].data.size() * 4) == 0;
    return same;
}

bool all_finite(const Film& film) {
    for (const Layer& layer : film.layers)
        for (float value : layer.data)
            if (!std::isfinite(value)) return false;
    return true;
}

glm::dmat4 clip_matrix(const Scene& scene) {
    return scene.camera.world_to_clip(double(scene.film.width) / scene.film.height);
}

/// The direction through a place of the film, in pixels, y from the top.
glm::dvec3 ray_through(const Scene& scene, double x, double y) {
    const glm::dvec2 ndc(2 * x / scene.film.width - 1, 1 - 2 * y / scene.film.height);
    const glm::dvec4 q = glm::inverse(clip_matrix(scene)) * glm::dvec4(ndc, 0, 1);
    return glm::normalize(glm::dvec3(q) / q.w - scene.camera.eye);
}

double depth_of(const Scene& scene, glm::dvec3 point) {
    const glm::dvec4 q = clip_matrix(scene) * glm::dvec4(point, 1);
    return 0.5 * q.z / q.w + 0.5;
}

struct Plane {
    glm::dvec3 point, normal;
    glm::dvec3 hit(glm::dvec3 eye, glm::dvec3 ray) const {
        return eye + ray * (glm::dot(point - eye, normal) / glm::dot(ray, normal));
    }
};

/// How far a picture of a plane lies from the truth.
struct Errors {
    int seen = 0;
    double position = 0;  ///< across the ray: seen at a grazing angle, it is longer along the ray
    double depth = 0, normal = 0;
};

/// `reach`: how far corners lie from the eye, when they lie much farther than what is seen. Their clip coordinates are float32,
/// 2^-24 of the reach, and become depth over the w of the pixel: depth errors are counted in that unit then.
Errors compare(const Scene& scene, const Drawn& drawn, const Plane& plane, glm::dvec3 normal, double reach = 0) {
    Errors errors;
    for (int y = 0; y < scene.film.height; ++y)
        for (int x = 0; x < scene.film.width; ++x) {
            if (!drawn.covered(x, y)) continue;
            const glm::dvec3 ray = ray_through(scene, x + 0.5, y + 0.5), truth = plane.hit(scene.camera.eye, ray);
            const double grazing = std::abs(glm::dot(ray, plane.normal));
            const auto keep = [](double& most, double error) { most = error <= most ? most : error; };  // also NaN
            keep(errors.position, glm::length(drawn.vector("position", x, y) - truth) * grazing);
            const double w = (clip_matrix(scene) * glm::dvec4(truth, 1)).w;
            keep(errors.depth,
                 std::abs(drawn.value("depth", x, y) - depth_of(scene, truth)) / std::max(1.0, reach / w));
            keep(errors.normal, glm::length(drawn.vector("normal", x, y) - normal));
            ++errors.seen;
        }
    return errors;
}

/// How often each pixel is covered in all, as a share of its samples, when each mesh is drawn for itself.
std::vector<double> times_covered(const Scene& scene, const std::vector<Mesh>& meshes) {
    std::vector<double> sum(size_t(scene.film.width) * scene.film.height);
    for (const Mesh& mesh : meshes) {
        const Drawn drawn = draw_scene(scene, {mesh});
        for (size_t i = 0; i < sum.size(); ++i) sum[i] += drawn.film.find("coverage")->data[i];
    }
    return sum;
}

/// Triangle i goes to part i % parts.
std::vector<Mesh> dealt(const Mesh& mesh, int parts) {
    std::vector<Mesh> out(size_t(parts), mesh);
    for (Mesh& part : out) part.indices.clear();
    for (size_t t = 0; t < mesh.triangle_count(); ++t)
        for (size_t k = 0; k < 3; ++k) out[t % size_t(parts)].indices.push_back(mesh.indices[3 * t + k]);
    return out;
}

int others_than(const std::vector<double>& values, double expected) {
    return int(std::count_if(values.begin(), values.end(), [&](double v) { return v != expected; }));
}

/// A grid in the plane z = 0, x and y from -half to half.
Mesh sheet(int across, int up, double half_width, double half_height) {
    Mesh mesh;
    for (int j = 0; j <= up; ++j)
        for (int i = 0; i <= across; ++i)
            mesh.positions.push_back(
                glm::vec3((2.0 * i / across - 1) * half_width, (2.0 * j / up - 1) * half_height, 0));
    mesh.normals.assign(mesh.positions.size(), glm::vec3(0, 0, 1));
    for (int j = 0; j < up; ++j)
        for (int i = 0; i < across; ++i) {
            const uint32_t a = uint32_t(j * (across + 1) + i), b = a + 1, c = a + uint32_t(across) + 1, d = c + 1;
            mesh.indices.insert(mesh.indices.end(), {a, b, d, a, d, c});
        }
    return mesh;
}

/// Triangles around a vertex at `centre`, their outer corners given.
Mesh fan(glm::dvec3 centre, const std::vector<glm::dvec3>& ring) {
    std::vector<glm::dvec3> points = {centre};
    points.insert(points.end(), ring.begin(), ring.end());
    std::vector<uint32_t> indices;
    for (size_t i = 0; i < ring.size(); ++i)
        indices.insert(indices.end(), {0, uint32_t(i + 1), uint32_t((i + 1) % ring.size() + 1)});
    return mesh_of(points, indices);
}

}  // namespace

// -------------------------------------------------------------------------------------------- near plane and far away

TEMPLATE_TEST_CASE("a floor under and behind the eye: the ray's own point at every pixel", "", float, double) {
    constexpr bool is_double = std::is_same_v<TestType, double>;
    Random random(40);
    Errors worst;
    for (int round = 0; round < 12; ++round) {
        Scene scene = scene_with(97, 75);
        const double half = round % 3 == 0 ? 400 : 60, near = 0.1, far = 150;
        const double pitch = random.uniform(-0.1, 1.3), heading = random.uniform(0, 6.28);
        const glm::dvec3 forward(std::cos(heading) * std::cos(pitch), -std::sin(pitch),
                                 std::sin(heading) * std::cos(pitch));
        const glm::dvec3 eye(random.uniform(-5, 5), random.uniform(0.5, 2), random.uniform(-5, 5));
        scene.camera = {eye, eye + forward, {random.uniform(-0.3, 0.3), 1, 0}, 1.2, near, far};
        // Two triangles, a few and many: with one of 400 all is clipped, with one of 60 / 16 only what the eye stands on.
        Mesh floor = sheet(round % 3 == 2 ? 16 : 1, round % 3 == 2 ? 16 : 1, half, half);
        for (glm::vec3& p : floor.positions) p = {p.x, 0, p.y};
        floor.normals.assign(floor.normals.size(), {0, 1, 0});
        const Drawn drawn = draw_scene<TestType>(scene, {floor});
        CHECK(drawn.statistics.clipped_triangles > 0);

        int missed = 0, spurious = 0;
        for (int y = 0; y < 75; ++y)
            for (int x = 0; x < 97; ++x) {
                bool surely = true, maybe = false;  // within 1/20 pixel of a border either is right
                for (double dy : {-0.05, 0.05})
                    for (double dx : {-0.05, 0.05}) {
                        const glm::dvec3 ray = ray_through(scene, x + 0.5 + dx, y + 0.5 + dy);
                        const glm::dvec3 hit = eye - ray * (eye.y / ray.y);
                        const double distance = glm::dot(hit - eye, forward);
                        const bool inside = ray.y < 0 && distance > near && distance < far &&
                                            std::max(std::abs(hit.x), std::abs(hit.z)) < half;
                        surely &= inside, maybe |= inside;
                    }
                missed += surely && !drawn.covered(x, y);
                spurious += !maybe && drawn.covered(x, y);
            }
        const Errors errors = compare(scene, drawn, {{0, 0, 0}, {0, 1, 0}}, {0, 1, 0}, is_double ? 0 : 1.5 * half);
        CAPTURE(round, pitch, heading);
        CHECK(missed == 0);
        CHECK(spurious == 0);
        CHECK(all_finite(drawn.film));
        worst.seen += errors.seen;
        worst.position = std::max(worst.position, errors.position / half);
        worst.depth = std::max(worst.depth, errors.depth);
        worst.normal = std::max(worst.normal, errors.normal);
    }
    CHECK(worst.seen > 20000);
    // Double adds nothing to the film's own rounding to float32.
    CHECK(worst.position <= (is_double ? 1 : 8) * ulp);
    CHECK(worst.depth <= (is_double ? 0.51 : 4) * ulp);
    CHECK(worst.normal <= 2 * ulp);
}

TEST_CASE("corners 1e5 to 1e6 film widths away: the film is covered once, along the edges of exact arithmetic") {
    Random random(41);
    int compared = 0, wrong = 0, covered = 0;
    for (int round = 0; round < 30; ++round) {
        Scene scene = scene_with(128, 96);
        scene.film.samples = round % 2 ? 4 : 1;
        const double film_width = 2 * 3 * std::tan(glm::radians(25.0)) * 128 / 96;  // at the origin
        std::vector<glm::dvec3> ring;
        const int corners = 3 + round % 5;
        for (int k = 0; k < corners; ++k) {
            const double angle = 2 * glm::radians(180.0) * (k + random.uniform(0, 0.5)) / corners;
            const double reach = film_width * std::pow(10, random.uniform(5, 6));
            ring.push_back({reach * std::cos(angle), reach * std::sin(angle), 0});
        }
        const glm::dvec3 centre(random.uniform(-1, 1), random.uniform(-1, 1), 0);
        const Mesh mesh = fan(centre, ring);
        CAPTURE(round);
        CHECK(others_than(times_covered(scene, dealt(mesh, corners)), 1) == 0);
        // A single one: where its edges cross the film. The corners' float32 clip coordinates count as given. A cut in the
        // guard band, up to 8192 pixels away, is put onto the grid within 1/512 pixel; float32 holds it to 1/1024 more.
        const Mesh one = dealt(mesh, corners)[0];
        scene.film.samples = 1;
        const Drawn drawn = draw_scene(scene, {one});
        const glm::mat4 m(clip_matrix(scene));
        glm::dvec3 h[3];  // homogeneous pixel coordinates
        for (int k = 0; k < 3; ++k) {
            const glm::vec3 p = one.positions[one.indices[size_t(k)]];
            glm::vec4 c;
            for (int r = 0; r < 4; ++r) c[r] = ((m[0][r] * p.x + m[1][r] * p.y) + m[2][r] * p.z) + m[3][r];
            h[k] = {(double(c.x) + c.w) * 64, (double(c.w) - c.y) * 48, c.w};
        }
        for (int y = 0; y < 96; ++y)
            for (int x = 0; x < 128; ++x) {
                double nearest = 1e30;
                bool inside[2] = {true, true};
                for (int k = 0; k < 3; ++k) {
                    const glm::dvec3 edge = glm::cross(h[k], h[(k + 1) % 3]);
                    const double distance =
                        glm::dot(edge, glm::dvec3(x + 0.5, y + 0.5, 1)) / std::hypot(edge.x, edge.y);
                    nearest = std::min(nearest, std::abs(distance));
                    inside[0] &= distance > 0, inside[1] &= distance < 0;
                }
                covered += inside[0] || inside[1];
                if (nearest < 0.01) continue;
                ++compared;
                wrong += drawn.covered(x, y) != (inside[0] || inside[1]);
            }
    }
    CHECK(wrong == 0);
    CHECK(compared > 300000);
    CHECK(covered > 50000);
}

TEST_CASE("near and far a billion apart: depth grows with the distance, and nothing is NaN") {
    for (const double near : {1e-3, 1.0}) {
        Scene scene = scene_with(24, 20);
        scene.camera = {{0, 0, 0}, {0, 0, -1}, {0, 1, 0}, glm::radians(60.0), near, 1e9};
        double before = -1, truth_before = -1;
        int drawn_ones = 0, steps = 0;
        for (double distance = near * 1.01; distance < 0.99e9; distance *= 1.7) {
            const double half = 2 * distance;
            scene.objects[0].to_world = glm::translate(glm::dmat4(1), glm::dvec3(0, 0, -distance));
            const Drawn drawn = draw_scene(scene, {sheet(1, 1, half, half)});
            const Drawn exact = draw_scene<double>(scene, {sheet(1, 1, half, half)});
            REQUIRE(all_finite(drawn.film));
            REQUIRE(all_finite(exact.film));
            const double truth = depth_of(scene, {0, 0, -distance});
            CAPTURE(near, distance, truth);
            ++steps;
            // What rounds to 1 is as far as the cleared depth and not drawn, as with OpenGL's less. Anything nearer is seen.
            if (truth < 1 - 4 * ulp) REQUIRE(drawn.covered(12, 10));
            if (!drawn.covered(12, 10)) continue;
            ++drawn_ones;
            for (const auto& [x, y] : {std::pair(0, 0), {23, 0}, {12, 10}, {0, 19}, {23, 19}}) {
                REQUIRE(drawn.covered(x, y));
                const double depth = drawn.value("depth", x, y);
                CHECK((depth >= 0 && depth < 1));
                CHECK(std::abs(depth - truth) <= 4 * ulp);
                CHECK(depth >= before - 4 * ulp);
                if (truth > truth_before + 8 * ulp) CHECK(depth > before);
                const glm::dvec3 ray = ray_through(scene, x + 0.5, y + 0.5), hit = ray * (distance / -ray.z);
                CHECK(glm::length(drawn.vector("position", x, y) - hit) <= 16 * ulp * distance);
                CHECK(drawn.vector("normal", x, y) == glm::dvec3(0, 0, 1));
            }
            before = drawn.value("depth", 12, 10), truth_before = truth;
        }
        CHECK(drawn_ones > 25);
        CHECK(steps > 35);
    }
    // A floor from the eye to the horizon in one picture, its rows each half as long again as the one before. (As a single square
    // it would have no picture: 1e9 away float32 does not hold what tells the near plane from the eye. But no NaN either.)
    Scene scene = scene_with(64, 64);
    scene.camera = {{0, 1, 0}, {0, 1, -1}, {0, 1, 0}, glm::radians(60.0), 1e-3, 1e9};
    std::vector<glm::dvec3> points;
    std::vector<uint32_t> indices;
    for (double z = 0.5; z < 1e9; z *= 1.5) {
        points.insert(points.end(), {{-4 * z, 0, -z}, {4 * z, 0, -z}});
        const uint32_t n = uint32_t(points.size());
        if (n > 2) indices.insert(indices.end(), {n - 4, n - 3, n - 1, n - 4, n - 1, n - 2});
    }
    const Drawn drawn = draw_scene(scene, {mesh_of(points, indices, {0, 1, 0})});
    CHECK(all_finite(drawn.film));
    int seen = 0, unordered = 0;
    for (int y = 32; y < 64; ++y) {
        seen += drawn.covered(32, y);
        if (y > 32) unordered += drawn.value("depth", 32, y) > drawn.value("depth", 32, y - 1);
    }
    CHECK(seen == 32);
    CHECK(unordered == 0);
    const double far = 1e9;
    CHECK(all_finite(draw_scene(scene, {mesh_of({{-far, 0, far}, {far, 0, far}, {far, 0, -far}, {-far, 0, -far}},
                                                {0, 1, 2, 0, 2, 3}, {0, 1, 0})})
                         .film));
}

// ------------------------------------------------------------------------------------------- small, thin, on the edge

TEST_CASE("a million triangles smaller than a pixel: each pixel once, each at the plane's depth") {
    Scene scene = scene_with(256, 256);
    // Tilted, and beyond the film on all sides; positions exact in float32, so that the plane is one.
    Mesh mesh = sheet(1000, 500, 1000.0 / 256, 500.0 / 128);
    for (glm::vec3& p : mesh.positions) p.z = 0.125f * p.x - 0.25f * p.y;
    const glm::dvec3 normal = glm::normalize(glm::dvec3(-0.125, 0.25, 1));
    mesh.normals.assign(mesh.normals.size(), glm::vec3(normal));
    REQUIRE(mesh.triangle_count() == 1000000);
    const Drawn drawn = draw_scene(scene, {mesh});
    const Errors errors = compare(scene, drawn, {{0, 0, 0}, normal}, normal);
    CHECK(errors.seen == 256 * 256);
    CHECK(errors.position <= 16 * ulp);
    CHECK(errors.depth <= 4 * ulp);
    CHECK(errors.normal <= 4 * ulp);
    CHECK(others_than(times_covered(scene, dealt(mesh, 2)), 1) == 0);
    // With more samples, and tiles on whose borders triangles hold samples but no pixel centre.
    for (int samples : {2, 4, 8, 16, 64}) {
        Scene small = scene_with(130, 70);
        small.film.samples = samples;
        CHECK(others_than(times_covered(small, dealt(sheet(300, 150, 3, 2), 2)), 1) == 0);
    }
    // The same with a border: the sheet ends inside of the film, and the rest shows the background.
    mesh = sheet(1000, 500, 1, 1);
    const std::vector<double> counts = times_covered(scene, dealt(mesh, 2));
    for (int y = 0; y < 256; ++y)
        for (int x = 0; x < 256; ++x) {
            const glm::dvec3 hit =
                Plane{{0, 0, 0}, {0, 0, 1}}.hit(scene.camera.eye, ray_through(scene, x + 0.5, y + 0.5));
            const double off = std::max(std::abs(hit.x), std::abs(hit.y)) - 1;
            if (std::abs(off) > 1e-4 && counts[size_t(y * 256 + x)] != (off < 0))
                FAIL_CHECK("pixel " << x << ", " << y);
        }
}

TEST_CASE("slivers, ten million times as long as wide, leave no hole and carry no wrong point") {
    Random random(42);
    Errors worst;
    for (int round = 0; round < 40; ++round) {
        Scene scene = scene_with(100, 90);
        scene.film.samples = round % 4 == 3 ? 4 : 1;
        // A square in a tilted plane, cut along a line into two halves with slivers between them, two by two.
        const double turn = random.uniform(0, 6.28), width = 4e-7, half = 2;
        const int slivers = 2 * int(random.integer(1, 10));
        std::vector<glm::dvec3> points;
        std::vector<uint32_t> indices;
        const double shift = random.uniform(-1, 1);
        std::vector<double> cuts = {-4};
        for (int i = 0; i <= slivers / 2; ++i) cuts.push_back(shift + i * width);
        cuts.push_back(4);
        for (double x : cuts)
            for (double y : {-half, half})
                points.push_back({x * std::cos(turn) - y * std::sin(turn), x * std::sin(turn) + y * std::cos(turn), 0});
        for (uint32_t i = 0; i + 1 < cuts.size(); ++i)
            indices.insert(indices.end(), {2 * i, 2 * i + 2, 2 * i + 3, 2 * i, 2 * i + 3, 2 * i + 1});
        Mesh mesh = mesh_of(points, indices);
        scene.objects[0].to_world = glm::rotate(glm::dmat4(1), random.uniform(-0.6, 0.6), random.direction());
        const glm::dvec3 normal(scene.objects[0].to_world * glm::dvec4(0, 0, 1, 0));
        const Drawn drawn = draw_scene(scene, {mesh});
        const Errors errors = compare(scene, drawn, {{0, 0, 0}, normal}, normal);
        worst.position = std::max(worst.position, errors.position);
        worst.depth = std::max(worst.depth, errors.depth);
        worst.normal = std::max(worst.normal, errors.normal);
        worst.seen += errors.seen;
        CHECK(all_finite(drawn.film));
        const std::vector<double> counts = times_covered(scene, dealt(mesh, int(mesh.triangle_count())));
        int wrong = 0;
        for (int y = 0; y < 90; ++y)
            for (int x = 0; x < 100; ++x) {
                const glm::dvec3 hit =
                    Plane{{0, 0, 0}, normal}.hit(scene.camera.eye, ray_through(scene, x + 0.5, y + 0.5));
                const glm::dvec3 own(glm::transpose(glm::dmat3(scene.objects[0].to_world)) * hit);
                const double u = own.x * std::cos(turn) + own.y * std::sin(turn),
                             v = own.y * std::cos(turn) - own.x * std::sin(turn);
                // Farther from the border than a pixel is wide (0.03, tilted or nearer up to 0.1) all samples are on one side.
                const double off = std::max(std::abs(u) - 4, std::abs(v) - half);
                if (std::abs(off) > 0.2) wrong += counts[size_t(y * 100 + x)] != (off < 0);
            }
        CAPTURE(round, slivers);
        CHECK(wrong == 0);
    }
    CHECK(worst.seen > 100000);
    CHECK(worst.position <= 32 * ulp);
    CHECK(worst.depth <= 4 * ulp);
    CHECK(worst.normal <= 4 * ulp);
}

TEST_CASE("a fan of a thousand triangles around a pixel's centre covers each sample once") {
    Random random(43);
    for (int samples : {1, 2, 4, 8, 16, 64}) {
        VisibilityTile first = empty_tile(samples), last = empty_tile(samples);
        const Point centre{31 * 256, 30 * 256};
        std::vector<ScreenTriangle> triangles;
        std::vector<Point> ring;
        for (int i = 0; i < 1000; ++i) {
            const double angle = 2 * glm::radians(180.0) * (i + random.uniform(-0.3, 0.3)) / 1000;
            const double radius =
                random.uniform(24, 26) * 256;  // never less than half as long as its neighbours: a star
            ring.push_back(
                {centre.x + std::lround(radius * std::cos(angle)), centre.y + std::lround(radius * std::sin(angle))});
        }
        for (uint32_t i = 0; i < 1000; ++i) {
            ScreenTriangle t{{}, i};
            const Point corners[3] = {centre, ring[i], ring[(i + 1) % 1000]};
            REQUIRE(cross(corners[0], corners[1], corners[2]) > 0);
            for (size_t k = 0; k < 3; ++k)
                t.vertex[(k + i) % 3] = {int32_t(corners[k].x), int32_t(corners[k].y), float(i + 1) / 2048};
            triangles.push_back(t);
            rasterize(t, {0, 0}, samples, first);
            for (ScreenVertex& v : t.vertex) v.z = 1 - v.z;
            rasterize(t, {0, 0}, samples, last);
        }
        CHECK(first.triangle == last.triangle);  // whoever is nearest: there is only one
        int wrong = 0;
        for (int s = 0; s < samples; ++s)
            for (int y = 0; y < tile_size; ++y)
                for (int x = 0; x < tile_size; ++x) {
                    const Point p = sample_at({x, y}, sample_positions(samples)[size_t(s)]);
                    const double radius = std::hypot(double(p.x - centre.x), double(p.y - centre.y));
                    const uint32_t seen = first.triangle[size_t((s * tile_size + y) * tile_size + x)];
                    if (seen != no_triangle) wrong += !covers_exactly(triangles[seen], p);
                    if (radius < 23 * 256) wrong += seen == no_triangle;
                    if (radius > 26.1 * 256) wrong += seen != no_triangle;
                }
        CHECK(wrong == 0);
    }
    // And through draw(), in perspective; the middle of 65 x 65 pixels is a pixel's centre.
    Scene scene = scene_with(65, 65);
    std::vector<glm::dvec3> ring;
    for (int i = 0; i < 1000; ++i)
        ring.push_back(glm::dvec3(std::cos(2 * glm::radians(180.0) * i / 1000),
                                  std::sin(2 * glm::radians(180.0) * i / 1000), 0.25) *
                       4.0);
    const Mesh mesh = fan({0, 0, 0}, ring);
    for (int samples : {1, 4, 64}) {
        scene.film.samples = samples;
        CHECK(others_than(times_covered(scene, dealt(mesh, 2)), 1) == 0);
    }
    CHECK(draw_scene(scene, {mesh}).vector("position", 32, 32) == glm::dvec3(0));
}

TEST_CASE("film borders: what ends on them fills the film, what starts on them is not seen") {
    for (const auto& [width, height] : {std::pair(1, 1), {1, 200}, {7, 5}, {64, 64}, {63, 65}, {130, 9}, {129, 127}})
        for (int samples : {1, 2, 4, 8, 16, 64}) {
            Scene scene = scene_with(width, height);
            scene.film.samples = samples;
            scene.camera = {{0, 0, 1}, {0, 0, 0}, {0, 1, 0}, glm::radians(90.0), 0.25, 4};
            const double aspect = double(width) / height;
            const auto square = [&](double left, double right, double bottom, double top) {  // in pixels, y upwards
                const auto at = [&](double x, double y) {
                    return glm::dvec3((2 * x / width - 1) * aspect, 2 * y / height - 1, 0);
                };
                return mesh_of({at(left, bottom), at(right, bottom), at(right, top), at(left, top)},
                               {0, 1, 2, 0, 2, 3});
            };
            CAPTURE(width, height, samples);
            const Drawn all = draw_scene(scene, {square(0, width, 0, height)});
            CHECK(others_than(std::vector<double>(all.film.find("coverage")->data.begin(),
                                                  all.film.find("coverage")->data.end()),
                              1) == 0);
            CHECK(others_than(times_covered(scene, dealt(square(0, width, 0, height), 2)), 1) == 0);
            for (const Mesh& outside : {square(-width, 0, 0, height), square(width, 2 * width, 0, height),
                                        square(0, width, -height, 0), square(0, width, height, 2 * height)})
                CHECK(draw_scene(scene, {outside}).statistics.fragments == 0);
            if (samples > 1) continue;
            // From the centres of the first pixels to those of the last: left and bottom edges own, right and top ones do not.
            const Drawn centres = draw_scene(scene, {square(0.5, width - 0.5, 0.5, height - 0.5)});
            int wrong = 0;
            for (int y = 0; y < height; ++y)
                for (int x = 0; x < width; ++x)
                    wrong += centres.covered(x, y) != (x < width - 1 && height - 1 - y < height - 1);
            CHECK(wrong == 0);
        }
}

TEST_CASE("the depth layer is within 4 x 2^-24 of double for well-shaped triangles") {
    Random random(44);
    double worst = 0, worst_exact = 0;
    int seen = 0;
    for (int round = 0; round < 200; ++round) {
        Scene scene = scene_with(120, 90);
        scene.camera.eye = {0.3, 0.4, 3};
        const Mesh mesh = mesh_of({random.in_box(1.2), random.in_box(1.2), random.in_box(1.2)}, {0, 1, 2});
        glm::dvec3 c[3];
        glm::dvec2 film[3];
        for (int k = 0; k < 3; ++k) {
            c[k] = glm::dvec3(mesh.positions[size_t(k)]);
            const glm::dvec4 q = clip_matrix(scene) * glm::dvec4(c[k], 1);
            film[k] = glm::dvec2(q.x * 60, q.y * 45) / q.w;
        }
        const auto side = [&](int k) { return glm::length(film[(k + 1) % 3] - film[k]); };
        const glm::dvec2 a = film[1] - film[0], b = film[2] - film[0];
        if (std::abs(a.x * b.y - a.y * b.x) < 16 * std::max({side(0), side(1), side(2)})) continue;  // 16 pixels high
        const Plane plane{c[0], glm::normalize(glm::cross(c[1] - c[0], c[2] - c[0]))};
        const Errors errors = compare(scene, draw_scene(scene, {mesh}), plane, {0, 0, 1});
        worst = std::max(worst, errors.depth);
        worst_exact = std::max(worst_exact, compare(scene, draw_scene<double>(scene, {mesh}), plane, {0, 0, 1}).depth);
        seen += errors.seen;
    }
    CHECK(seen > 20000);
    CHECK(worst <= 4 * ulp);
    CHECK(worst_exact <= 0.51 * ulp);  // the reference's is that of double, rounded once
}

// ---------------------------------------------------------------------------------------- far from the world's origin

namespace {

/// Draws a scene file as the renderer's main program does.
Drawn draw_file(const std::filesystem::path& file) {
    static const Manifest manifest =
        load_manifest(SHADELAB_ROOT "/solution/phong", SHADELAB_ROOT "/framework/interface.toml");
    Scene scene = load_scene(file, manifest);
    scene.materials[0].model = "white";
    std::vector<Mesh> meshes;
    for (Object& object : scene.objects) {
        meshes.push_back(load_mesh(object.mesh, object.normals));
        object.to_world = glm::translate(object.to_world, meshes.back().origin);
    }
    return draw_scene(scene, meshes);
}

}  // namespace

TEST_CASE("a scene a hundred million away looks as it does at the origin") {
    // A bumpy patch whose coordinates are multiples of 1/256, which double holds even next to 1e8.
    const auto patch = [](glm::dvec3 by) {
        std::string text;
        char line[200];
        for (int j = 0; j <= 16; ++j)
            for (int i = 0; i <= 16; ++i) {
                std::snprintf(line, sizeof line, "v %.8f %.8f %.8f\n", by.x + (i - 8) / 8.0, by.y + (j - 8) / 8.0,
                              by.z + ((i * 7 + j * 5) % 16) / 64.0);
                text += line;
            }
        for (int j = 0; j < 16; ++j)
            for (int i = 0; i < 16; ++i) {
                const int a = 17 * j + i + 1;
                std::snprintf(line, sizeof line, "f %d %d %d %d\n", a, a + 1, a + 18, a + 17);
                text += line;
            }
        return text;
    };
    const auto scene = [](glm::dvec3 by, glm::dvec3 translate, const std::string& mesh) {
        char text[1200];
        std::snprintf(
            text, sizeof text,
            "[film]\nwidth = 120\nheight = 100\n[camera]\neye = [%.8f, %.8f, %.8f]\ntarget = [%.8f, %.8f, %.8f]\n"
            "near = 0.5\nfar = 20\n[[light]]\nkind = \"directional\"\ndirection = [0, 0, -1]\nintensity = [1, 1, 1]\n"
            "[material.m]\nmodel = \"phong\"\nka = [0, 0, 0]\nkd = [1, 1, 1]\nks = [0, 0, 0]\nq = 1\n"
            "[[object]]\nmesh = \"%s\"\nmaterial = \"m\"\ntranslate = [%.8f, %.8f, %.8f]\n",
            by.x + 0.5, by.y + 0.75, by.z + 3, by.x, by.y, by.z, mesh.c_str(), translate.x, translate.y, translate.z);
        return std::string(text);
    };
    const TemporaryFolder folder;
    folder.write("here.obj", patch(glm::dvec3(0)));
    const Drawn here = draw_file(folder.write("here.toml", scene(glm::dvec3(0), glm::dvec3(0), "here.obj")));
    int covered = 0;
    for (float id : here.film.find("id")->data) covered += id == 1;
    REQUIRE(covered > 3000);
    for (const glm::dvec3 by : {glm::dvec3(1e6, -2e6, 5e5), glm::dvec3(0, 0, 1e8), glm::dvec3(1e8, 1e8, -1e8),
                                glm::dvec3(1e8 + 0.1, 0.3, 0.7)}) {
        const bool exact =
            by.x == std::floor(by.x);  // otherwise double itself loses up to 1e8 x 2^-53, a fifth of 2^-24
        CAPTURE(by.x, by.y, by.z);
        // The object is moved there: less the scene's origin it is the same object, to the last bit.
        if (exact) CHECK(identical(here.film, draw_file(folder.write("there.toml", scene(by, by, "here.obj"))).film));
        // The mesh itself lies there: its positions are relative to the middle of its box, and to_world brings them back. What
        // differs is the rounding of clip coordinates, by some 2^-24 of 4.
        folder.write("there.obj", patch(by));
        const Drawn there = draw_file(folder.write("mesh.toml", scene(by, glm::dvec3(0), "there.obj")));
        // The same mesh, taken back by the object: the product of the two in double loses 1e8 x 2^-53.
        const Drawn back = draw_file(folder.write("back.toml", scene(glm::dvec3(0), -by, "there.obj")));
        for (const Drawn* other : {&there, &back}) {
            int elsewhere = 0;
            double position = 0, normal = 0, depth = 0;
            for (int y = 0; y < 100; ++y)
                for (int x = 0; x < 120; ++x) {
                    elsewhere += other->covered(x, y) != here.covered(x, y);
                    if (!other->covered(x, y) || !here.covered(x, y)) continue;
                    position = std::max(position,
                                        glm::length(other->vector("position", x, y) - here.vector("position", x, y)));
                    normal = std::max(normal, glm::length(other->vector("normal", x, y) - here.vector("normal", x, y)));
                    depth = std::max(depth, std::abs(double(other->value("depth", x, y)) - here.value("depth", x, y)));
                }
            CHECK(elsewhere <= (exact ? 0 : 2));
            CHECK(position <= 4 * ulp);
            CHECK(normal <= 4 * ulp);
            CHECK(depth <= 4 * ulp);
        }
    }
}

// ------------------------------------------------------------------------------------- behind, degenerate, not finite

TEMPLATE_TEST_CASE("the inside of an open mesh is drawn, with the mesh's own normals, also mirrored", "", float,
                   double) {
    // An open tube about the z axis with the eye in it, looking along it; normals point outwards, away from the eye.
    Mesh tube;
    const int around = 48;
    for (int i = 0; i < around; ++i)
        for (double z : {-6.0, 4.0}) {
            const double angle = 2 * glm::radians(180.0) * i / around;
            tube.positions.push_back(glm::vec3(std::cos(angle), std::sin(angle), z));
            tube.normals.push_back(glm::vec3(std::cos(angle), std::sin(angle), 0));
        }
    for (uint32_t i = 0; i < around; ++i) {
        const uint32_t a = 2 * i, b = a + 1, c = 2 * ((i + 1) % around), d = c + 1;
        tube.indices.insert(tube.indices.end(), {a, c, d, a, d, b});
    }
    Mesh turned = tube;
    for (size_t t = 0; t < turned.triangle_count(); ++t)
        std::swap(turned.indices[3 * t + 1], turned.indices[3 * t + 2]);
    for (const glm::dvec3 scale : {glm::dvec3(1), glm::dvec3(-1, 1, 1), glm::dvec3(1, 2, 1), glm::dvec3(1, -2, -1)}) {
        Scene scene = scene_with(80, 80);
        scene.camera = {{0.1, 0.2, 3}, {0, 0, 0}, {0, 1, 0}, glm::radians(60.0), 0.1, 100};
        scene.objects[0].to_world = glm::scale(glm::dmat4(1), scale);
        const Drawn drawn = draw_scene<TestType>(scene, {tube});
        CAPTURE(scale.x, scale.y, scale.z);
        CHECK(all_finite(drawn.film));
        const Drawn other = draw_scene<TestType>(scene, {turned});  // whichever way the triangles run
        int seen = 0, elsewhere = 0;
        double different = 0;
        double off = 0, inwards = 1;
        for (int y = 0; y < 80; ++y)
            for (int x = 0; x < 80; ++x) {
                elsewhere += drawn.covered(x, y) != other.covered(x, y);
                if (!drawn.covered(x, y)) continue;
                ++seen;
                // The tube's own normal at that place, off by at most half a side's angle in the chord's place.
                const glm::dvec3 p = drawn.vector("position", x, y), n = drawn.vector("normal", x, y);
                const glm::dvec3 expected =
                    glm::normalize(glm::dvec3(p.x / (scale.x * scale.x), p.y / (scale.y * scale.y), 0));
                off = std::max(off, glm::length(n - expected));
                const double facing = glm::dot(n, glm::normalize(p - scene.camera.eye));
                inwards = std::min(inwards, facing);
                different = std::max({different, glm::length(other.vector("position", x, y) - p) * facing,
                                      glm::length(other.vector("normal", x, y) - n) * facing});
            }
        CHECK(elsewhere == 0);
        CHECK(different <= (std::is_same_v<TestType, double> ? 1 : 160) * ulp);  // narrow sides, coordinates of up to 6
        CHECK(seen > 4000);
        CHECK(off < 0.005);
        CHECK(inwards > 0);  // pointing away from the eye, and left so
    }
}

TEST_CASE("degenerate triangles draw nothing and disturb nobody") {
    Random random(45);
    for (int samples : {1, 4}) {
        Scene scene = scene_with(90, 70);
        scene.film.samples = samples;
        Mesh mesh = sheet(6, 6, 1.2, 1.2);
        const Drawn clean = draw_scene(scene, {mesh});
        std::vector<uint32_t> indices = mesh.indices;
        const uint32_t vertices = uint32_t(mesh.positions.size());
        mesh.indices.clear();
        for (size_t t = 0; t < indices.size(); t += 3) {
            const auto any = [&] { return uint32_t(random.integer(0, vertices - 1)); };
            const uint32_t a = any(), b = any(), row = 7 * uint32_t(random.integer(0, 6));
            mesh.indices.insert(mesh.indices.end(),
                                {a, a, a, a, a, b, a, b, a, b, a, a});             // a point, and lines there and back
            mesh.indices.insert(mesh.indices.end(), {row + 1, row + 3, row + 6});  // three corners in a row
            mesh.indices.insert(mesh.indices.end(), indices.begin() + long(t), indices.begin() + long(t) + 3);
        }
        // And nearer to the eye, where they would be seen: all in one point, on one line, and off each other by less than a step.
        const uint32_t first = uint32_t(mesh.positions.size());
        for (const glm::dvec3 p :
             {glm::dvec3(0, 0, 1), {0, 0, 1}, {0.25, 0.25, 1}, {-0.5, -0.5, 1}, {1e-30, 0, 1}, {0, 1e-30, 1}})
            mesh.positions.push_back(glm::vec3(p)), mesh.normals.push_back({0, 0, 1});
        mesh.indices.insert(mesh.indices.end(),
                            {first, first + 1, first + 2, first, first + 2, first + 3, first, first + 4, first + 5});
        const Drawn drawn = draw_scene(scene, {mesh});
        CHECK(identical(clean.film, drawn.film));
        CHECK(drawn.statistics.fragments == clean.statistics.fragments);
        // A whole mesh of nothing else.
        Mesh nothing = mesh;
        nothing.indices = {0, 0, 0, 1, 2, 3, first, first + 1, first + 2};
        CHECK(draw_scene(scene, {nothing}).statistics.fragments == 0);
    }
}

TEMPLATE_TEST_CASE("vertices that are not finite are counted and never drawn; their neighbours are", "", float,
                   double) {
    const float nan = std::nanf(""), infinity = INFINITY;
    for (const float bad : {nan, infinity, -infinity, 3e38f, -3e38f})
        for (int axis = 0; axis < 3; ++axis)
            for (Interpolation interpolation : {Interpolation::phong, Interpolation::gouraud}) {
                Scene scene = scene_with(80, 60, 2);
                scene.objects[0].interpolation = interpolation;
                scene.objects[1].to_world = glm::translate(glm::dmat4(1), glm::dvec3(0, 0, -0.5));
                Mesh mesh = sheet(6, 6, 0.9, 0.9);
                const Mesh behind = mesh;
                std::vector<uint32_t> broken = {10, 24, 25, 38};
                Mesh without = mesh;  // the same less the triangles that touch a broken vertex
                without.indices.clear();
                for (size_t t = 0; t < mesh.indices.size(); t += 3)
                    if (std::none_of(broken.begin(), broken.end(), [&](uint32_t v) {
                            return mesh.indices[t] == v || mesh.indices[t + 1] == v || mesh.indices[t + 2] == v;
                        }))
                        without.indices.insert(without.indices.end(), mesh.indices.begin() + long(t),
                                               mesh.indices.begin() + long(t) + 3);
                for (uint32_t v : broken) mesh.positions[v][axis] = bad;
                mesh.positions.push_back(glm::vec3(bad));  // nobody's corner, but counted
                mesh.normals.push_back({0, 0, 1});
                without.positions.push_back(glm::vec3(0));
                without.normals.push_back({0, 0, 1});
                const Drawn drawn = draw_scene<TestType>(scene, {mesh, behind}),
                            expected = draw_scene<TestType>(scene, {without, behind});
                CAPTURE(bad, axis);
                if (std::isfinite(bad)) {
                    // Finite itself, but not where it lands: 3e38 times the projection is beyond float32, along most axes. Where
                    // it is not, the triangle is real and reaches that far; nothing may be NaN.
                    CHECK(all_finite(drawn.film));
                    CHECK(drawn.statistics.not_finite_fragments == 0);
                    continue;
                }
                CHECK(drawn.statistics.not_finite_vertices == 5);
                CHECK(drawn.statistics.triangles == 144);
                CHECK(drawn.statistics.not_finite_fragments == 0);
                CHECK(drawn.statistics.fragments == expected.statistics.fragments);
                CHECK(identical(drawn.film, expected.film));
                CHECK(all_finite(drawn.film));
            }
}
