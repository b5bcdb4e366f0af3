// draw() as a whole: what a shading function is given, and what the film shows for it.
#include "support.hpp"

#include <catch2/catch.hpp>

#include <glm/gtc/matrix_transform.hpp>
#include <omp.h>

#include <algorithm>
#include <cstring>
#include <numeric>

using namespace shadelab;
using namespace shadelab::testing;

namespace {

// ------------------------------------------------------------------ a plugin: colours that show what the framework passes in

/// total += light.intensity * f(n, x, v, material), where every light kind shades alike.
template <bool Layers, class Real, class F>
void add_colour(const plugin::Batch<Real>& batch, const Real* material, const Real* light, F colour) {
    using vec3 = glm::vec<3, Real>;
    const vec3 intensity(light[7], light[8], light[9]);
    for (int i = 0; i < batch.count; ++i) {
        const auto in = [&](int k) { return vec3(batch.in[k][i], batch.in[k + 1][i], batch.in[k + 2][i]); };
        const vec3 value = intensity * colour(in(0), in(3), in(6), material);
        for (int c = 0; c < 3; ++c) {
            batch.out[c][i] += value[c];
            if (Layers)
                for (int layer = 1; layer <= 3; ++layer)
                    batch.out[3 * layer + c][i] += value[c] * Real(layer) / 6;  // they sum to the total
        }
    }
}

/// Layers: as a plugin compiled with SHADELAB_TERMS=1.
template <class Real, bool Layers>
struct TestPlugin {
    using vec3 = glm::vec<3, Real>;
    using Batch = plugin::Batch<Real>;
    static void normal(const Batch& b, const Real* m, const Real* l) {
        add_colour<Layers>(b, m, l, [](vec3 n, vec3, vec3, const Real*) { return n; });
    }
    static void position(const Batch& b, const Real* m, const Real* l) {
        add_colour<Layers>(b, m, l, [](vec3, vec3 x, vec3, const Real*) { return x; });
    }
    static void view(const Batch& b, const Real* m, const Real* l) {
        add_colour<Layers>(b, m, l, [](vec3, vec3, vec3 v, const Real*) { return v; });
    }
    static void constant(const Batch& b, const Real* m, const Real* l) {
        add_colour<Layers>(b, m, l, [](vec3, vec3, vec3, const Real* p) { return vec3(p[0], p[1], p[2]); });
    }
    static void affine(const Batch& b, const Real* m, const Real* l) {
        add_colour<Layers>(b, m, l, [](vec3, vec3 x, vec3, const Real*) {
            return vec3(x.x + 2 * x.y - x.z + 1, x.y - 3, 4 * x.z - x.x);
        });
    }
    static void bumpy(const Batch& b, const Real* m, const Real* l) {
        add_colour<Layers>(b, m, l, [](vec3 n, vec3 x, vec3 v, const Real*) { return n * (x.x + x.y * x.z) + v; });
    }
    static void half_nan(const Batch& b, const Real* m, const Real* l) {
        add_colour<Layers>(b, m, l, [](vec3, vec3 x, vec3, const Real*) {
            return vec3(1) / (x.x - x.y > Real(0.3) ? Real(0) : Real(1));
        });
    }

    template <plugin::Shade<Real> shade>
    static constexpr plugin::Shade<Real> loops[] = {shade, shade, shade};
    std::vector<plugin::Model<Real>> models = {
        {"normal", 9, columns_of_nxv, loops<normal>},    {"position", 9, columns_of_nxv, loops<position>},
        {"view", 9, columns_of_nxv, loops<view>},        {"constant", 9, columns_of_nxv, loops<constant>},
        {"affine", 9, columns_of_nxv, loops<affine>},    {"bumpy", 9, columns_of_nxv, loops<bumpy>},
        {"half_nan", 9, columns_of_nxv, loops<half_nan>}};
    plugin::Table<Real> table() const {
        return {plugin::abi_version, sizeof(Real), Layers, 3, int(models.size()), 0, models.data(), nullptr};
    }
};

// --------------------------------------------------------------------------------------------------------- scenes by hand

Scene scene_with(const std::string& model, int width, int height, int objects = 1) {
    Scene scene;
    scene.film.width = width;
    scene.film.height = height;
    scene.camera = {{0.3, 0.4, 3}, {0, 0, 0}, {0, 1, 0}, glm::radians(50.0), 0.1, 100};
    scene.light_kinds = light_kinds;
    Light light{};
    light.kind = directional;
    light.placed = false;
    light.intensity = glm::dvec3(1);
    scene.lights = {light};
    scene.materials = {{"plain", model, {1, 1, 1}}};
    for (int i = 0; i < objects; ++i) {
        Object object;
        object.material = 0;
        scene.objects.push_back(object);
    }
    return scene;
}

/// A unit sphere with exact normals, rings x segments.
Mesh sphere(int rings, int segments) {
    Mesh mesh;
    for (int j = 0; j <= rings; ++j)
        for (int i = 0; i < segments; ++i) {
            const double theta = glm::radians(180.0) * j / rings, phi = 2 * glm::radians(180.0) * i / segments;
            mesh.positions.push_back(
                glm::vec3(std::sin(theta) * std::cos(phi), std::cos(theta), std::sin(theta) * std::sin(phi)));
            mesh.normals.push_back(mesh.positions.back());
        }
    for (int j = 0; j < rings; ++j)
        for (int i = 0; i < segments; ++i) {
            const uint32_t a = uint32_t(j * segments + i), b = uint32_t(j * segments + (i + 1) % segments),
                           c = a + uint32_t(segments), d = b + uint32_t(segments);
            mesh.indices.insert(mesh.indices.end(), {a, b, d, a, d, c});
        }
    return mesh;
}

struct Drawn {
    Film film;
    DrawStatistics statistics;
    const float* pixel(const char* layer, int x, int y) const {
        return film.find(layer)->pixel(size_t(y) * film.width + x);
    }  // y from the top
};

template <class Real>
Drawn draw_scene(const Scene& scene, const std::vector<Mesh>& meshes, bool layers = true, bool full = false) {
    const Features features = Features::of(scene, {.terms = layers, .geometry = layers, .full = full});
    Drawn out{Film(scene.film.width, scene.film.height, features, scene.film.background), {}};
    if (features.term_layers)
        out.statistics = draw<Real>(scene, features, meshes, TestPlugin<Real, true>().table(), out.film);
    else
        out.statistics = draw<Real>(scene, features, meshes, TestPlugin<Real, false>().table(), out.film);
    return out;
}

bool identical(const std::vector<float>& a, const std::vector<float>& b) {
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
}

bool identical(const Film& a, const Film& b) {
    bool same = a.layers.size() == b.layers.size();
    for (size_t l = 0; same && l < a.layers.size(); ++l) same = identical(a.layers[l].data, b.layers[l].data);
    return same;
}

/// Clip coordinates as OpenGL's software renderer computes them: matrix in double, rounded, then float32 column by column.
glm::vec4 clip_position(const Scene& scene, glm::vec3 p) {
    const glm::mat4 m(scene.camera.world_to_clip(double(scene.film.width) / scene.film.height) *
                      scene.objects[0].to_world);
    glm::vec4 out;
    for (int r = 0; r < 4; ++r) out[r] = ((m[0][r] * p.x + m[1][r] * p.y) + m[2][r] * p.z) + m[3][r];
    return out;
}

/// The ray through the centre of pixel (x, y), y from the top.
glm::dvec3 pixel_ray(const Scene& scene, int x, int y) {
    const glm::dvec2 ndc((x + 0.5) / scene.film.width * 2 - 1, 1 - (y + 0.5) / scene.film.height * 2);
    const glm::dvec4 q =
        glm::inverse(scene.camera.world_to_clip(double(scene.film.width) / scene.film.height)) * glm::dvec4(ndc, 0, 1);
    return glm::normalize(glm::dvec3(q) / q.w - scene.camera.eye);
}

// What Real adds to an exact computation: a few units in the last place of the largest coordinate. Weights come from
// differences of clip coordinates times the film's width (a cancellation by some 2^4 for triangles of a sixteenth of the film
// and more), so 2^4 x ten roundings x 2^-24. The film itself stores float32.
template <class Real>
constexpr double interpolation_error = std::is_same_v<Real, double> ? 2 * 0x1p-24 : 160 * 0x1p-24;

}  // namespace

TEMPLATE_TEST_CASE("interpolation in perspective: a point on the triangle's plane and on the pixel's ray", "", float,
                   double) {
    Random random(20);
    int seen = 0, clipped = 0;
    for (int round = 0; round < 60; ++round) {
        Scene scene = scene_with("position", 70, 45);
        scene.camera.near = 0.5;
        Mesh mesh;
        if (round % 2)  // a deep triangle, up to and behind the eye
            mesh = mesh_of({{-3 + random.uniform(), -2, random.uniform(1, 6)},
                            {3 + random.uniform(), -1, random.uniform(-8, 2)},
                            {random.uniform(-1, 1), 3, random.uniform(-8, 2)}},
                           {0, 1, 2});
        else
            mesh = mesh_of({random.in_box(1.5), random.in_box(1.5), random.in_box(1.5)}, {0, 1, 2});
        glm::dvec3 corner[3];
        for (int k = 0; k < 3; ++k) corner[k] = mesh.positions[size_t(k)];
        const glm::dvec3 normal = glm::normalize(glm::cross(corner[1] - corner[0], corner[2] - corner[0]));
        const Drawn drawn = draw_scene<TestType>(scene, {mesh});
        clipped += int(drawn.statistics.clipped_triangles);
        double plane_error = 0, ray_error = 0, view_error = 0;
        for (int y = 0; y < 45; ++y)
            for (int x = 0; x < 70; ++x) {
                if (drawn.pixel("id", x, y)[0] != 1) continue;
                const glm::dvec3 ray = pixel_ray(scene, x, y);
                // Seen at a grazing angle, an error across the ray becomes a longer one along it; edge-on is another matter.
                const double grazing = std::abs(glm::dot(ray, normal));
                if (grazing < 0.15) continue;
                const float* p = drawn.pixel("total", x, y);
                const glm::dvec3 position(p[0], p[1], p[2]), from_eye = position - scene.camera.eye;
                plane_error = std::max(plane_error, std::abs(glm::dot(position - corner[0], normal)));
                ray_error = std::max(ray_error, glm::length(glm::cross(from_eye, ray)) * grazing);
                view_error = std::max(view_error, glm::length(glm::dvec3(drawn.pixel("position", x, y)[0],
                                                                         drawn.pixel("position", x, y)[1],
                                                                         drawn.pixel("position", x, y)[2]) -
                                                              position));
                ++seen;
            }
        CAPTURE(round);
        CHECK(plane_error <= interpolation_error<TestType> * 8);  // coordinates of up to 8
        CHECK(ray_error <= interpolation_error<TestType> * 8);
        CHECK(view_error == 0);  // the layer shows what the function was given
    }
    CHECK(seen > 10000);
    CHECK(clipped > 10);
}

TEMPLATE_TEST_CASE("v is the unit vector from the surface to the eye", "", float, double) {
    const Scene scene = scene_with("view", 64, 48);
    const Drawn drawn = draw_scene<TestType>(scene, {sphere(20, 30)});
    int seen = 0;
    for (int y = 0; y < 48; ++y)
        for (int x = 0; x < 64; ++x) {
            if (drawn.pixel("id", x, y)[0] != 1) continue;
            const float* v = drawn.pixel("total", x, y);
            CHECK(glm::length(glm::dvec3(v[0], v[1], v[2]) + pixel_ray(scene, x, y)) <=
                  interpolation_error<TestType> * 4);  // small triangles: cancellation by 2^6
            ++seen;
        }
    CHECK(seen > 500);
}

TEMPLATE_TEST_CASE("colours interpolated from vertices reproduce an affine function, as the fragments themselves do",
                   "", float, double) {
    Random random(21);
    for (int round = 0; round < 10; ++round) {
        Scene scene = scene_with("affine", 64, 64);
        scene.objects[0].to_world =
            glm::rotate(glm::translate(glm::dmat4(1), random.in_box(0.3)), random.uniform(0, 6), random.direction());
        const Mesh mesh = mesh_of({random.in_box(1.5), random.in_box(1.5), random.in_box(1.5), random.in_box(1.5)},
                                  {0, 1, 2, 1, 3, 2});
        const Drawn fragments = draw_scene<TestType>(scene, {mesh});
        scene.objects[0].interpolation = Interpolation::gouraud;
        const Drawn vertices = draw_scene<TestType>(scene, {mesh});
        CHECK(identical(fragments.film.find("position")->data, vertices.film.find("position")->data));
        double difference = 0, terms = 0;
        for (int y = 0; y < 64; ++y)
            for (int x = 0; x < 64; ++x) {
                const float* p = fragments.pixel("position", x, y);
                const bool covered = fragments.pixel("id", x, y)[0] == 1;
                const glm::dvec3 expected =
                    covered ? glm::dvec3(p[0] + 2.0 * p[1] - p[2] + 1, p[1] - 3.0, 4.0 * p[2] - p[0]) : glm::dvec3(0);
                for (int c = 0; c < 3; ++c) {
                    difference = std::max({difference, std::abs(fragments.pixel("total", x, y)[c] - expected[c]),
                                           std::abs(vertices.pixel("total", x, y)[c] - expected[c])});
                    for (const Drawn* d : {&fragments, &vertices}) {
                        const double sum = double(d->pixel("ambient", x, y)[c]) + d->pixel("diffuse", x, y)[c] +
                                           d->pixel("specular", x, y)[c];
                        terms = std::max(terms, std::abs(sum - d->pixel("total", x, y)[c]));
                    }
                }
            }
        // The weights are the same bits in both ways and sum to 1, so only the products round: values of up to 16, ten roundings.
        CHECK(difference <= 10 * 16 * 0x1p-24);
        CHECK(terms <= 10 * 16 * 0x1p-24);
    }
    // A function that is not affine must tell the two ways apart.
    Scene scene = scene_with("bumpy", 64, 64);
    const Drawn fragments = draw_scene<TestType>(scene, {sphere(4, 6)});
    scene.objects[0].interpolation = Interpolation::gouraud;
    CHECK_FALSE(identical(fragments.film, draw_scene<TestType>(scene, {sphere(4, 6)}).film));
}

TEST_CASE("coverage of the film is exact at every sample count, across tiles, and weights sum to it") {
    Random random(22);
    for (int samples : {1, 2, 4, 8, 16, 64}) {
        for (int round = 0; round < 8; ++round) {
            Scene scene = scene_with("constant", 131, 70);  // two tiles and a bit
            scene.film.samples = samples;
            scene.film.background = {0.25, 0.5, 4};
            const double size = round % 3 == 0 ? 0.1 : 1.5;  // small ones may hold samples but no pixel centre
            // Far from the origin clip coordinates are small differences of large numbers: then it matters, by a sub-pixel and
            // more, that they are added in the order in which OpenGL's renderer adds them.
            const glm::dvec3 away = round % 2 ? glm::dvec3(1000, -700, 300) : glm::dvec3(0);
            scene.camera.eye += away;
            scene.camera.target += away;
            std::vector<glm::dvec3> corners;
            std::vector<uint32_t> indices;
            for (int t = 0; t < (round % 3 == 0 ? 30 : 4); ++t) {
                const glm::dvec3 centre = away + random.in_box(1);
                for (int k = 0; k < 3; ++k) {
                    indices.push_back(uint32_t(corners.size()));
                    corners.push_back(centre + random.in_box(size));
                }
            }
            const Mesh mesh = mesh_of(corners, indices);
            std::vector<ScreenTriangle> screen;
            for (size_t t = 0; t < mesh.triangle_count(); ++t) {
                const glm::vec4 clip[3] = {clip_position(scene, mesh.positions[3 * t]),
                                           clip_position(scene, mesh.positions[3 * t + 1]),
                                           clip_position(scene, mesh.positions[3 * t + 2])};
                clip_and_project(clip, scene.film.width, scene.film.height, uint32_t(t), screen);
            }
            const Drawn drawn = draw_scene<float>(scene, {mesh});
            int wrong = 0, partial = 0, wrong_total = 0;
            for (int y = 0; y < scene.film.height; ++y)
                for (int x = 0; x < scene.film.width; ++x) {
                    int covered = 0;
                    for (glm::ivec2 sample : sample_positions(samples)) {
                        const Point p = sample_at({x, scene.film.height - 1 - y}, sample);
                        covered += std::any_of(screen.begin(), screen.end(),
                                               [&](const ScreenTriangle& t) { return covers_exactly(t, p); });
                    }
                    const float share = float(covered) / float(samples);
                    wrong += drawn.pixel("coverage", x, y)[0] != share;  // sums of powers of two: no rounding at all
                    partial += covered > 0 && covered < samples;
                    for (int c = 0; c < 3; ++c) {
                        // White over the background; 64 additions of numbers of at most 4 round by 64 x 2^-23 at most.
                        const double expected = scene.film.background[c] + share * (1 - scene.film.background[c]);
                        wrong_total += std::abs(drawn.pixel("total", x, y)[c] - expected) > 64 * 0x1p-23;
                        wrong_total += std::abs(drawn.pixel("specular", x, y)[c] - 0.5 * share) > 64 * 0x1p-24;
                    }
                }
            CAPTURE(samples, round);
            CHECK(wrong == 0);
            CHECK(wrong_total == 0);
            CHECK((partial > 0) == (samples > 1));
        }
    }
}

TEST_CASE("geometry layers are those of the pixel's centre, whatever the sample count") {
    Scene scene = scene_with("constant", 100, 80, 2);
    scene.objects[1].to_world = glm::translate(glm::dmat4(1), glm::dvec3(0.8, 0.3, 0.4));
    const std::vector<Mesh> meshes = {sphere(12, 16), sphere(9, 12)};
    const Drawn once = draw_scene<float>(scene, meshes);
    for (int samples : {2, 16}) {
        scene.film.samples = samples;
        const Drawn many = draw_scene<float>(scene, meshes);
        for (const char* layer : {"id", "depth", "normal", "position"})
            CHECK(identical(once.film.find(layer)->data, many.film.find(layer)->data));
        CHECK(many.statistics.fragments > once.statistics.fragments);
    }
    // The layers agree with each other: depth is that of the position, the normal is a unit vector, and both objects show.
    int seen[3] = {0, 0, 0};
    for (int y = 0; y < 80; ++y)
        for (int x = 0; x < 100; ++x) {
            const int id = int(once.pixel("id", x, y)[0]);
            REQUIRE((id >= 0 && id <= 2));
            ++seen[id];
            const float depth = once.pixel("depth", x, y)[0], *p = once.pixel("position", x, y),
                        *n = once.pixel("normal", x, y);
            if (id == 0) {
                CHECK((depth == 1 && p[0] == 0 && n[0] == 0));
                continue;
            }
            const glm::dvec4 clip = scene.camera.world_to_clip(1.25) * glm::dvec4(p[0], p[1], p[2], 1);
            // On the sphere's rim a triangle's depth may change by 1e-3 within the sub-pixel that corners are snapped by.
            CHECK(std::abs(clip.z / clip.w * 0.5 + 0.5 - depth) < 1e-3);
            CHECK(std::abs(glm::length(glm::dvec3(n[0], n[1], n[2])) - 1) <= 4 * 0x1p-24);
        }
    CHECK((seen[0] > 1000 && seen[1] > 500 && seen[2] > 500));
}

TEST_CASE("the nearer object is seen in whatever order objects stand; of equal depths the first") {
    const Mesh square = mesh_of({{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}}, {0, 1, 2, 0, 2, 3});
    const glm::dmat4 nearer = glm::translate(glm::dmat4(1), glm::dvec3(0, 0, 0.5));
    for (int first_is_nearer : {0, 1}) {
        Scene scene = scene_with("constant", 32, 32, 2);
        scene.objects[first_is_nearer ? 0 : 1].to_world = nearer;
        const Drawn drawn = draw_scene<float>(scene, {square, square});
        CHECK(drawn.pixel("id", 16, 16)[0] == (first_is_nearer ? 1 : 2));
    }
    const Drawn drawn = draw_scene<float>(scene_with("constant", 32, 32, 3), {square, square, square});
    CHECK(drawn.pixel("id", 16, 16)[0] == 1);
}

TEMPLATE_TEST_CASE("the image does not depend on the number of threads, to the last bit", "", float, double) {
    // Two objects of more triangles than a stretch of the binning (16384), interpenetrating and with equal depths; every pixel
    // holds several; one object is shaded at its vertices.
    Scene scene = scene_with("bumpy", 200, 130, 3);
    scene.objects[1].to_world = glm::translate(glm::dmat4(1), glm::dvec3(0.3, 0.2, 0.1));
    scene.objects[1].interpolation = Interpolation::gouraud;
    scene.film.background = {0.1, 0.2, 0.3};
    const std::vector<Mesh> meshes = {sphere(100, 120), sphere(70, 90), sphere(100, 120)};
    const int threads_before = omp_get_max_threads();
    for (int samples : {1, 4}) {
        scene.film.samples = samples;
        omp_set_num_threads(1);
        const Drawn one = draw_scene<TestType>(scene, meshes);
        for (int threads : {2, 5}) {
            omp_set_num_threads(threads);
            const Drawn many = draw_scene<TestType>(scene, meshes);
            CHECK(identical(one.film, many.film));
            CHECK(one.statistics.fragments == many.statistics.fragments);
        }
    }
    omp_set_num_threads(threads_before);
}

TEMPLATE_TEST_CASE("normals are unit vectors between the vertices' after interpolation", "", float, double) {
    Scene scene = scene_with("normal", 64, 64);
    scene.objects[0].to_world =
        glm::scale(glm::rotate(glm::dmat4(1), 1.0, glm::dvec3(1, 2, 3)), glm::dvec3(0.5, 1.3, -0.8));
    const Mesh mesh = sphere(8, 8);  // coarse: halfway between two vertices the plain average is shorter by a tenth
    const Drawn drawn = draw_scene<TestType>(scene, {mesh});
    int seen = 0;
    for (int y = 0; y < 64; ++y)
        for (int x = 0; x < 64; ++x) {
            if (drawn.pixel("id", x, y)[0] != 1) continue;
            const float *n = drawn.pixel("total", x, y), *p = drawn.pixel("position", x, y);
            CHECK(std::abs(glm::length(glm::dvec3(n[0], n[1], n[2])) - 1) <= 4 * 0x1p-24);
            // About the ellipsoid's own normal, M^-T (M^-1 x): the polyhedron deviates by up to 22.5 degrees at half a cell.
            const glm::dvec3 on_sphere =
                glm::inverse(glm::dmat3(scene.objects[0].to_world)) * glm::dvec3(p[0], p[1], p[2]);
            const glm::dvec3 expected =
                glm::normalize(glm::transpose(glm::inverse(glm::dmat3(scene.objects[0].to_world))) * on_sphere);
            CHECK(glm::dot(expected, glm::dvec3(n[0], n[1], n[2])) > 0.95);
            ++seen;
        }
    CHECK(seen > 300);
    CHECK(drawn.statistics.fallback_normals == 0);
}

TEST_CASE("a light at the very point that is shaded is counted") {
    Scene scene = scene_with("normal", 61, 61);
    scene.camera.eye = {0, 0, 2};
    const Mesh mesh = mesh_of({{0, 1, 0.25}, {-2, -1, 0}, {2, -1, 0}}, {0, 1, 2});
    const Drawn before = draw_scene<float>(scene, {mesh});
    const float* x = before.pixel("position", 30, 33);
    scene.lights = {Light{point}, Light{point}, Light{directional, false}};
    scene.lights[0].position = scene.lights[2].position = {x[0], x[1], x[2]};
    scene.lights[1].position = {x[0], x[1], x[2] + 1e-3};
    for (Light& light : scene.lights) light.intensity = glm::dvec3(1);
    CHECK(draw_scene<float>(scene, {mesh}).statistics.lights_at_surface == 1);
    scene.objects[0].interpolation = Interpolation::gouraud;
    CHECK(draw_scene<float>(scene, {mesh}).statistics.lights_at_surface == 0);
    scene.lights[1].position = {-2, -1, 0};
    CHECK(draw_scene<float>(scene, {mesh}).statistics.lights_at_surface == 1);
}

TEMPLATE_TEST_CASE("where vertex normals cancel the face normal stands in, and is counted", "", float, double) {
    // A triangle parallel to the film with normals +z, -z, -z: along the line of weight 1/2 of the first corner they cancel.
    // With an odd number of rows that line, half the triangle's height, is the middle row of pixels. |2 w - 1| passes 1e-4 in
    // less than a pixel, so no other row is concerned.
    for (bool mirror : {false, true}) {
        for (bool clockwise : {false, true}) {
            Scene scene = scene_with("normal", 61, 61);
            scene.camera.eye = {0, 0, 2};
            Mesh mesh = mesh_of({{0, 1, 0}, {-2, -1, 0}, {2, -1, 0}}, {0, 1, 2});
            if (clockwise) std::swap(mesh.indices[1], mesh.indices[2]);
            mesh.normals = {{0, 0, 1}, {0, 0, -1}, {0, 0, -1}};
            mesh.opposing_normals = true;
            if (mirror) scene.objects[0].to_world = glm::scale(glm::dmat4(1), glm::dvec3(-1, 1, 1));
            const Drawn drawn = draw_scene<TestType>(scene, {mesh});
            int covered = 0;
            for (int y = 0; y < 61; ++y)
                for (int x = 0; x < 61; ++x) {
                    if (drawn.pixel("id", x, y)[0] != 1) continue;
                    const float* n = drawn.pixel("total", x, y);
                    CAPTURE(x, y, mirror, clockwise);
                    CHECK((n[0] == 0 && n[1] == 0));
                    // The face normal belongs to the object: it turns over with the winding, not with a mirroring of x.
                    CHECK(std::abs(n[2] - (y < 30 ? 1 : y > 30 ? -1 : clockwise ? -1 : 1)) <= 2 * 0x1p-24);
                    covered += y == 30;
                }
            CHECK(covered > 20);
            CHECK(drawn.statistics.fallback_normals == covered);
            CHECK(drawn.statistics.not_finite_fragments == 0);
        }
    }
    // A transform that squeezes z makes opposing normals of harmless ones: (s, 0, +-c) with s small becomes (0.01 s, 0, +-c).
    Scene scene = scene_with("normal", 61, 61);
    scene.camera.eye = {0, 0, 2};
    Mesh mesh = mesh_of({{0, 1, 0}, {-2, -1, 0}, {2, -1, 0}}, {0, 1, 2});
    mesh.normals = {glm::vec3(std::sqrt(0.51f), 0, 0.7f), glm::vec3(std::sqrt(0.51f), 0, -0.7f),
                    glm::vec3(std::sqrt(0.51f), 0, -0.7f)};
    CHECK(glm::dot(mesh.normals[0], mesh.normals[1]) > 0);  // so that opposing_normals is rightly false
    CHECK(draw_scene<TestType>(scene, {mesh}).statistics.fallback_normals == 0);
    scene.objects[0].to_world = glm::scale(glm::dmat4(1), glm::dvec3(1, 1, 1e-6));
    CHECK(draw_scene<TestType>(scene, {mesh}).statistics.fallback_normals > 20);
}

TEST_CASE("lights add up one by one, in double as in float") {
    const Mesh mesh = sphere(10, 12);
    Scene scene = scene_with("constant", 20, 20);
    scene.materials[0].parameters = {0.5, 1, 2};
    scene.lights.assign(3, scene.lights[0]);
    scene.lights[0].kind = point;
    scene.lights[1].kind = spot;
    scene.lights[0].intensity = {1, 2, 3};
    scene.lights[1].intensity = {10, 20, 30};
    scene.lights[2].intensity = {100, 200, 300};
    for (const Drawn& drawn : {draw_scene<float>(scene, {mesh}), draw_scene<double>(scene, {mesh})}) {
        const float* p = drawn.pixel("total", 10, 10);
        CHECK((p[0] == 55.5f && p[1] == 222 && p[2] == 666));
    }
}

TEST_CASE("a scene without objects shows its background") {
    Scene scene = scene_with("normal", 70, 50, 0);
    scene.film.background = {0.25, 0.5, 1};
    for (const int samples : {1, 4}) {
        scene.film.samples = samples;
        const Drawn drawn = draw_scene<float>(scene, {});
        CHECK(drawn.statistics.triangles == 0);
        for (int i = 0; i < 70 * 50; ++i) {
            const float* p = drawn.film.find("total")->pixel(size_t(i));
            REQUIRE((p[0] == 0.25f && p[1] == 0.5f && p[2] == 1));
            REQUIRE((drawn.film.find("depth")->data[size_t(i)] == 1 && drawn.film.find("id")->data[size_t(i)] == 0));
        }
    }
}

TEST_CASE("a light of intensity zero is left out, and the image stays the same to the last bit") {
    Scene scene = scene_with("bumpy", 80, 60);
    Light dark = scene.lights[0];
    dark.intensity = glm::dvec3(0);
    scene.lights.insert(scene.lights.begin(), dark);
    scene.lights.push_back(dark);
    for (int i = 0; i < 3; ++i) scene.lights[size_t(i)].entry = i;
    scene.lights[2].kind = spot;
    scene.materials.push_back({"unused", "constant", {1, 1, 1}});
    scene.film.samples = 4;

    const Features lean = Features::of(scene, {}), full = Features::of(scene, {.full = true}),
                   layers = Features::of(scene, {.terms = true, .geometry = true});
    CHECK(lean.lights == std::vector<int>{1});
    CHECK(full.lights == std::vector<int>{0, 1, 2});
    CHECK(lean.materials == std::vector<int>{0});
    CHECK(full.materials == std::vector<int>{0, 1});
    CHECK((!lean.term_layers && !lean.geometry_layers && full.term_layers && full.geometry_layers &&
           layers.term_layers && layers.geometry_layers));
    CHECK((lean.per_fragment && !lean.gouraud));
    const auto mentions = [](const std::vector<std::string>& lines, const std::string& text) {
        return std::any_of(lines.begin(), lines.end(),
                           [&](const std::string& line) { return line.find(text) != std::string::npos; });
    };
    CHECK(mentions(lean.lines(false), "light[0] (directional): its intensity is zero"));
    CHECK(mentions(lean.lines(false), "light[2] (spot): its intensity is zero"));
    CHECK(mentions(lean.lines(true), "light[1] (directional): it shines"));
    CHECK(mentions(lean.lines(false), "material.unused"));
    CHECK(mentions(full.lines(true), "light[0] (directional): kept by --full"));
    CHECK_FALSE(mentions(full.lines(false), "light["));
    for (const Features* features : {&lean, &full})
        for (const bool needed : {false, true})
            for (const std::string& line : features->lines(needed)) CHECK(line.find('\n') == std::string::npos);

    const std::vector<Mesh> meshes = {sphere(20, 30)};
    for (Interpolation interpolation : {Interpolation::phong, Interpolation::gouraud}) {
        scene.objects[0].interpolation = interpolation;
        const Drawn with = draw_scene<float>(scene, meshes, false, true),
                    without = draw_scene<float>(scene, meshes, false, false);
        CHECK(without.film.layers.size() == 1);
        CHECK(identical(with.film.layers[0].data, without.film.layers[0].data));
    }
}

TEST_CASE("what is not finite is reported where it first stands, and not drawn where it is a vertex") {
    // Infinite where x - y > 0.3: of the four tiles three hold some, and the topmost is not the leftmost.
    Scene scene = scene_with("half_nan", 100, 100);
    scene.camera.eye = {0, 0, 3};
    const Mesh square = mesh_of({{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}}, {0, 1, 2, 0, 2, 3});
    const Drawn drawn = draw_scene<float>(scene, {square});
    int infinite = 0, first_x = -1, first_y = -1, leftmost = 100;
    for (int y = 0; y < 100; ++y)
        for (int x = 0; x < 100; ++x)
            if (!std::isfinite(drawn.pixel("total", x, y)[0])) {
                if (infinite++ == 0) first_x = x, first_y = y;
                leftmost = std::min(leftmost, x);
            }
    CHECK(infinite > 500);
    CHECK(leftmost < 40);
    CHECK(first_x > 64);
    CHECK(drawn.statistics.not_finite_fragments == infinite);
    REQUIRE(drawn.statistics.first_not_finite);
    const NotFinite& first = *drawn.statistics.first_not_finite;
    CHECK((first.x == first_x && first.y == first_y));
    CHECK((first.material == "plain" && first.model == "half_nan"));
    CHECK(first.position.x == drawn.pixel("position", first_x, first_y)[0]);
    CHECK(std::isinf(first.value.x));

    Mesh broken = square;
    broken.positions[3].x = INFINITY;
    Scene plain = scene_with("constant", 40, 40);
    const Drawn half = draw_scene<float>(plain, {broken});
    CHECK(half.statistics.not_finite_vertices == 1);
    CHECK(half.statistics.triangles == 2);
    CHECK(half.pixel("id", 24, 24)[0] == 1);  // the other triangle, right of the diagonal, is there
    CHECK(half.pixel("id", 13, 14)[0] == 0);
}
