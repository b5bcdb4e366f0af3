// Images and their files, read back with other code than wrote them.
#include "support.hpp"

#include <shadelab/error.hpp>

#include <catch2/catch.hpp>

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
#pragma GCC diagnostic ignored "-Wunused-function"
#pragma GCC diagnostic ignored "-Wunused-but-set-variable"
#pragma GCC diagnostic ignored "-Wsign-compare"
#define STB_IMAGE_STATIC
#define STB_IMAGE_IMPLEMENTATION
#define STBI_ONLY_PNG
#include <stb/stb_image.h>
#pragma GCC diagnostic pop

#include <cstring>
#include <set>

using namespace shadelab;
using namespace shadelab::testing;
using Catch::Matchers::Contains;

namespace {

constexpr float not_a_number = std::numeric_limits<float>::quiet_NaN(),
                infinity = std::numeric_limits<float>::infinity();

Film film_of(int width, int height, bool layers, glm::dvec3 background = glm::dvec3(0)) {
    Features features;
    features.term_layers = features.geometry_layers = layers;
    return Film(width, height, features, background);
}

/// Every number of every layer different, to see where each ends up.
Film numbered_film(int width, int height) {
    Film film = film_of(width, height, true);
    float next = 0;
    for (Layer& layer : film.layers)
        for (float& value : layer.data) value = next++ / 8;
    return film;
}

struct Png {
    int width = 0, height = 0;
    std::vector<uint8_t> bytes;
    glm::ivec3 at(int x, int y) const {
        const uint8_t* p = &bytes[size_t(y * width + x) * 3];
        return {p[0], p[1], p[2]};
    }
};

Png read_png(const std::filesystem::path& file) {
    Png out;
    int channels = 0;
    stbi_uc* data = stbi_load(file.c_str(), &out.width, &out.height, &channels, 3);
    REQUIRE(data);
    CHECK(channels == 3);
    out.bytes.assign(data, data + size_t(out.width) * out.height * 3);
    stbi_image_free(data);
    return out;
}

std::string read_bytes(const std::filesystem::path& file) {
    std::ifstream in(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
}

}  // namespace

TEST_CASE("a new film: background in the total, nothing elsewhere, depth at the far plane") {
    const Film plain = film_of(3, 2, false, {0.25, 0.5, 2});
    REQUIRE(plain.layers.size() == 1);
    CHECK(plain.channel_count() == 3);
    for (size_t i = 0; i < 6; ++i)
        CHECK((plain.layers[0].pixel(i)[0] == 0.25f && plain.layers[0].pixel(i)[1] == 0.5f &&
               plain.layers[0].pixel(i)[2] == 2));
    const Film full = film_of(3, 2, true, {0.25, 0.5, 2});
    std::string names;
    for (const Layer& layer : full.layers) names += layer.name + std::to_string(layer.channels) + " ";
    CHECK(names == "total3 ambient3 diffuse3 specular3 coverage1 id1 depth1 normal3 position3 ");
    CHECK(full.channel_count() == 21);
    CHECK(full.find("nothing") == nullptr);
    for (const Layer& layer : full.layers) {
        CHECK(full.find(layer.name) == &layer);
        CHECK(layer.data.size() == size_t(6 * layer.channels));
        if (layer.name != "total")
            for (float value : layer.data) CHECK(value == (layer.name == "depth" ? 1 : 0));
    }
}

TEST_CASE("npy: the header that NumPy asks for, then rows from the top with the channels side by side") {
    const TemporaryFolder folder;
    // Widths of one to four digits move the end of the header; the data must start at a multiple of 64 bytes all the same.
    for (const auto& [width, height] : {std::pair(5, 3), {1, 1}, {10, 2}, {123, 1}, {2, 4567}}) {
        const Film film = numbered_film(width, height);
        write_film(film, folder / "image.npy", 0);
        const std::string bytes = read_bytes(folder / "image.npy");
        REQUIRE(bytes.size() > 10);
        CHECK(bytes.substr(0, 8) == std::string("\x93NUMPY\x01\x00", 8));
        const size_t start = 10 + uint8_t(bytes[8]) + 256 * uint8_t(bytes[9]);
        CHECK(start % 64 == 0);
        REQUIRE(bytes.size() == start + size_t(width) * height * 21 * sizeof(float));
        const std::string header = bytes.substr(10, start - 10);
        CHECK_THAT(header,
                   Catch::Matchers::StartsWith("{'descr': '<f4', 'fortran_order': False, 'shape': (" +
                                               std::to_string(height) + ", " + std::to_string(width) + ", 21), }"));
        CHECK(header.back() == '\n');
        CHECK(header.find_first_not_of(' ', header.find('}') + 1) == header.size() - 1);
        std::vector<float> data((bytes.size() - start) / sizeof(float));
        std::memcpy(data.data(), &bytes[start], bytes.size() - start);
        size_t at = 0, wrong = 0;
        for (size_t pixel = 0; pixel < size_t(width) * height; ++pixel)
            for (const Layer& layer : film.layers)
                for (int c = 0; c < layer.channels; ++c) wrong += data[at++] != layer.data[pixel * layer.channels + c];
        CHECK(wrong == 0);
    }
    const Film plain = film_of(2, 2, false);
    write_film(plain, folder / "plain.npy", 0);
    CHECK_THAT(read_bytes(folder / "plain.npy"), Contains("'shape': (2, 2, 3)"));
}

TEST_CASE("png: sRGB bytes of known values, exposure, magenta for what is not a number") {
    const TemporaryFolder folder;
    // Linear values and their bytes by IEC 61966-2-1, worked out apart: 0.0031308 is where its two branches meet (12.92 x
    // 0.0031308 x 255 = 10.3), 0.2140411 is the linear value of 0.5 (127.5), 0.18 encodes to 0.46135.
    const struct {
        float linear;
        int byte;
    } known[] = {{0, 0},         {1, 255},    {0.0031308f, 10}, {0.5f, 188}, {0.18f, 118}, {0.2140f, 127},
                 {0.2141f, 128}, {0.001f, 3}, {-1, 0},          {2, 255},    {0.9f, 243},  {infinity, 255}};
    const int count = int(std::size(known));
    Film film = film_of(count + 5, 2, false);
    for (int x = 0; x < count; ++x) {
        film.layers[0].pixel(size_t(x))[0] = known[x].linear;
        film.layers[0].pixel(size_t(x))[1] = known[count - 1 - x].linear;
        film.layers[0].pixel(size_t(x))[2] = 1;
    }
    const glm::vec3 broken[5] = {
        {not_a_number, 0, 0}, {0, not_a_number, 0}, {1, 1, not_a_number}, glm::vec3(not_a_number), {-infinity, 0, 0}};
    for (int k = 0; k < 5; ++k)
        for (int c = 0; c < 3; ++c) film.layers[0].pixel(size_t(count + k))[c] = broken[k][c];
    film.layers[0].pixel(size_t(count + 5))[1] = 0.25f;  // the second row's first pixel
    write_film(film, folder / "image.png", 0);
    const Png png = read_png(folder / "image.png");
    REQUIRE((png.width == count + 5 && png.height == 2));
    for (int x = 0; x < count; ++x) {
        CAPTURE(known[x].linear);
        CHECK(png.at(x, 0) == glm::ivec3(known[x].byte, known[count - 1 - x].byte, 255));
    }
    for (int k = 0; k < 5; ++k) CHECK(png.at(count + k, 0) == glm::ivec3(255, 0, 255));
    CHECK(png.at(0, 1) == glm::ivec3(0, 137, 0));  // 0.25 encodes to 0.53710
    CHECK(png.at(1, 1) == glm::ivec3(0));

    write_film(film, folder / "bright.png", 1);  // 2 x 0.25 = 0.5
    CHECK(read_png(folder / "bright.png").at(0, 1) == glm::ivec3(0, 188, 0));
    write_film(film, folder / "dark.png", -1);  // 0.125 encodes to 0.38857
    CHECK(read_png(folder / "dark.png").at(0, 1) == glm::ivec3(0, 99, 0));
}

TEST_CASE("png: one file per layer") {
    const TemporaryFolder folder;
    Film film = film_of(2, 1, true);
    film.find("depth")->data = {0.5f, 1};
    film.find("normal")->data = {0, 0, 1, -1, not_a_number, 0};
    film.find("id")->data = {1, 2};
    film.find("ambient")->data = {0.5f, 0, 0, 0, 0, 0};
    write_film(film, folder / "image.png", 0);
    std::set<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder / "."))
        names.insert(entry.path().filename().string());
    CHECK(names == std::set<std::string>{"image.png", "image.ambient.png", "image.diffuse.png", "image.specular.png",
                                         "image.coverage.png", "image.id.png", "image.depth.png", "image.normal.png",
                                         "image.position.png"});
    const Png depth = read_png(folder / "image.depth.png"), normal = read_png(folder / "image.normal.png"),
              id = read_png(folder / "image.id.png");
    CHECK((depth.at(0, 0) == glm::ivec3(128) && depth.at(1, 0) == glm::ivec3(255)));
    CHECK((normal.at(0, 0) == glm::ivec3(128, 128, 255) && normal.at(1, 0) == glm::ivec3(255, 0, 255)));
    CHECK((id.at(0, 0) == glm::ivec3(128) && id.at(1, 0) == glm::ivec3(255)));
    CHECK(read_png(folder / "image.ambient.png").at(0, 0) == glm::ivec3(188, 0, 0));
}

TEST_CASE("exr: named float channels, the total in the root layer, rows from the top, every bit kept") {
    const TemporaryFolder folder;
    Film film = numbered_film(7, 4);
    film.layers[0].data[5] = infinity;
    film.layers[0].data[6] = 1e-30f;
    write_film(film, folder / "image.exr", 3);  // exposure is for PNG only
    Imf::InputFile in((folder / "image.exr").c_str());
    const Imath::Box2i window = in.header().dataWindow();
    CHECK((window.max.x - window.min.x + 1 == 7 && window.max.y - window.min.y + 1 == 4));
    std::set<std::string> names;
    for (auto channel = in.header().channels().begin(); channel != in.header().channels().end(); ++channel) {
        names.insert(channel.name());
        CHECK(channel.channel().type == Imf::FLOAT);
    }
    CHECK(names == std::set<std::string>{
                       "R",         "G",         "B",          "ambient.R",  "ambient.G",  "ambient.B",  "diffuse.R",
                       "diffuse.G", "diffuse.B", "specular.R", "specular.G", "specular.B", "coverage",   "id",
                       "depth",     "normal.X",  "normal.Y",   "normal.Z",   "position.X", "position.Y", "position.Z"});
    const struct {
        const char *channel, *layer;
        int component;
    } examples[] = {{"R", "total", 0},           {"G", "total", 1},     {"B", "total", 2},
                    {"diffuse.B", "diffuse", 2}, {"depth", "depth", 0}, {"position.Y", "position", 1}};
    for (const auto& example : examples) {
        std::vector<float> values(28);
        Imf::FrameBuffer frame;
        frame.insert(example.channel,
                     Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(values.data()), sizeof(float), 7 * sizeof(float)));
        in.setFrameBuffer(frame);
        in.readPixels(window.min.y, window.max.y);
        const Layer& layer = *film.find(example.layer);
        for (size_t i = 0; i < values.size(); ++i) CHECK(values[i] == layer.pixel(i)[example.component]);
    }
}

TEST_CASE("downsampling averages colours and coverage, and takes geometry from one sub-pixel") {
    const int n = 3, width = 4, height = 2;
    const Film large = numbered_film(width * n, height * n), small = large.downsampled(n);
    REQUIRE((small.width == width && small.height == height));
    for (const Layer& from : large.layers) {
        const Layer& to = *small.find(from.name);
        REQUIRE(to.data.size() == size_t(width * height * from.channels));
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x)
                for (int c = 0; c < from.channels; ++c) {
                    // The numbers grow evenly, so the mean of n x n of them is the one in the middle: both kinds agree here.
                    const float middle = from.pixel(size_t(y * n + 1) * width * n + x * n + 1)[c];
                    CHECK(to.pixel(size_t(y * width + x))[c] == middle);
                }
    }
    Film two = film_of(2, 2, true);
    two.find("total")->data = {1, 0, 0, 2, 0, 0, 3, 0, 0, 6, 0, 4};
    two.find("coverage")->data = {0, 1, 1, 1};
    two.find("id")->data = {1, 2, 3, 4};
    const Film one = two.downsampled(2);
    CHECK(one.find("total")->data == std::vector<float>{3, 0, 1});
    CHECK(one.find("coverage")->data == std::vector<float>{0.75f});
    CHECK(std::set<float>{1, 2, 3, 4}.count(one.find("id")->data[0]) ==
          1);  // an object that is there, never the mean 2.5
    const Film same = two.downsampled(1);
    CHECK(same.find("total")->data == two.find("total")->data);
}

TEST_CASE("unknown extensions are the user's error, files that cannot be written are not") {
    const TemporaryFolder folder;
    const Film film = film_of(2, 2, false);
    for (const char* name : {"image.jpg", "image", "image.PNGG"})
        CHECK_THROWS_AS(write_film(film, folder / name, 0), InputError);
    for (const char* name : {"no/image.png", "no/image.exr", "no/image.npy"}) {
        CHECK_THROWS_AS(write_film(film, folder / name, 0), InfrastructureError);
        CHECK_THROWS_WITH(write_film(film, folder / name, 0), Contains(name) && Contains("cannot be written"));
    }
}
