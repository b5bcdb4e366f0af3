#include <shadelab/film.hpp>

#include <shadelab/error.hpp>

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfOutputFile.h>

#define STB_IMAGE_WRITE_IMPLEMENTATION
#define STB_IMAGE_WRITE_STATIC
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
#pragma GCC diagnostic ignored "-Wunused-function"
#include <stb/stb_image_write.h>
#pragma GCC diagnostic pop

#include <algorithm>
#include <cmath>
#include <fstream>

namespace shadelab {

Film::Film(int width, int height, const Features& features, glm::dvec3 background, int samples)
    : width(width), height(height) {
    const size_t pixels = size_t(width) * height;
    const auto add = [&](const std::string& name, int channels) {
        layers.push_back({name, channels, std::vector<float>(pixels * channels, 0.0f)});
    };
    if (features.depth_only) {
        add("depth", 1);
        return;
    }
    if (features.visibility) {
        for (int s = 0; s < samples; ++s) add("triangle." + std::to_string(s), 1);
        for (int s = 0; s < samples; ++s) add("depth." + std::to_string(s), 1);
        return;
    }
    add("total", 3);
    const glm::vec3 colour(background);
    if (colour != glm::vec3(0))
        for (size_t i = 0; i < pixels; ++i) std::copy(&colour.x, &colour.x + 3, layers[0].pixel(i));
    if (features.term_layers) {
        for (const char* name : {"ambient", "diffuse", "specular"}) add(name, 3);
        add("coverage", 1);
    }
    if (features.geometry_layers) {
        add("id", 1);
        add("depth", 1);
        std::fill(layers.back().data.begin(), layers.back().data.end(),
                  1.0f);  // the far plane, as a cleared depth buffer
        add("normal", 3);
        add("position", 3);
    }
}

int Film::channel_count() const {
    int sum = 0;
    for (const Layer& layer : layers) sum += layer.channels;
    return sum;
}

Film Film::downsampled(int n) const {
    Film small = *this;
    small.width = width / n;
    small.height = height / n;
    for (size_t l = 0; l < layers.size(); ++l) {
        const Layer& from = layers[l];
        Layer& to = small.layers[l];
        to.data.assign(size_t(small.width) * small.height * to.channels, 0.0f);
        const bool geometry =
            from.name == "id" || from.name == "depth" || from.name == "normal" || from.name == "position";
        for (int y = 0; y < small.height; ++y)
            for (int x = 0; x < small.width; ++x)
                for (int c = 0; c < to.channels; ++c) {
                    const auto source = [&](int i, int j) {
                        return from.data[(size_t(y * n + j) * width + x * n + i) * from.channels + c];
                    };
                    double sum = 0;
                    for (int j = 0; j < n; ++j)
                        for (int i = 0; i < n; ++i) sum += source(i, j);
                    to.data[(size_t(y) * small.width + x) * to.channels + c] =
                        geometry ? source(n / 2, n / 2) : float(sum / (n * n));
                }
    }
    return small;
}

namespace {

/// IEC 61966-2-1. Not finite: the caller shows it; negative: 0.
uint8_t srgb_byte(double linear) {
    const double c = std::clamp(linear, 0.0, 1.0);
    const double encoded = c <= 0.0031308 ? 12.92 * c : 1.055 * std::pow(c, 1 / 2.4) - 0.055;
    return uint8_t(std::lround(255 * encoded));
}

void write_png(const Film& film, const Layer& layer, const std::string& file, double exposure) {
    std::vector<uint8_t> bytes(size_t(film.width) * film.height * 3);
    const bool light =
        layer.name == "total" || layer.name == "ambient" || layer.name == "diffuse" || layer.name == "specular";
    float largest = 0;  // of id and position, which have no natural range
    for (float value : layer.data)
        if (std::isfinite(value)) largest = std::max(largest, std::abs(value));
    for (size_t i = 0; i < size_t(film.width) * film.height; ++i) {
        const float* pixel = layer.pixel(i);
        bool finite = true;
        for (int c = 0; c < layer.channels; ++c) finite &= std::isfinite(pixel[c]) || (light && pixel[c] > 0);
        for (int c = 0; c < 3; ++c) {
            const double value = pixel[layer.channels == 3 ? c : 0];
            uint8_t& byte = bytes[3 * i + c];
            if (!finite)
                byte = c == 1 ? 0 : 255;  // magenta: never mistaken for black
            else if (light)
                byte = srgb_byte(value * std::exp2(exposure));
            else if (layer.name == "normal")
                byte = uint8_t(std::lround(255 * (0.5 * std::clamp(value, -1.0, 1.0) + 0.5)));
            else if (layer.name == "depth" || layer.name == "coverage")
                byte = uint8_t(std::lround(255 * std::clamp(value, 0.0, 1.0)));
            else
                byte = uint8_t(std::lround(255 * std::abs(value) / std::max(largest, 1e-30f)));
        }
    }
    if (!stbi_write_png(file.c_str(), film.width, film.height, 3, bytes.data(), film.width * 3))
        throw InfrastructureError(file + ": cannot be written; is the folder there and the disk not full?");
}

void write_exr(const Film& film, const std::string& file) {
    Imf::Header header(film.width, film.height);
    header.compression() = Imf::ZIP_COMPRESSION;
    Imf::FrameBuffer frame;
    for (const Layer& layer : film.layers) {
        const bool light =
            layer.name == "total" || layer.name == "ambient" || layer.name == "diffuse" || layer.name == "specular";
        const char* suffixes = layer.channels == 1 ? nullptr : light ? "RGB" : "XYZ";
        for (int c = 0; c < layer.channels; ++c) {
            // The total stands in the root layer, so that any viewer shows it first.
            const std::string prefix = layer.name == "total" ? "" : layer.name + (suffixes ? "." : "");
            const std::string name = prefix + (suffixes ? std::string(1, suffixes[c]) : "");
            header.channels().insert(name, Imf::Channel(Imf::FLOAT));
            char* base = reinterpret_cast<char*>(const_cast<float*>(layer.data.data() + c));
            const size_t stride = sizeof(float) * layer.channels;
            frame.insert(name, Imf::Slice(Imf::FLOAT, base, stride, stride * film.width));
        }
    }
    try {
        Imf::OutputFile out(file.c_str(), header);
        out.setFrameBuffer(frame);
        out.writePixels(film.height);
    } catch (const std::exception& error) {
        throw InfrastructureError(file + ": cannot be written: " + error.what());
    }
}

void write_npy(const Film& film, const std::string& file) {
    const int channels = film.channel_count();
    std::string header = "{'descr': '<f4', 'fortran_order': False, 'shape': (" + std::to_string(film.height) + ", " +
                         std::to_string(film.width) + ", " + std::to_string(channels) + "), }";
    header.append(63 - (10 + header.size()) % 64, ' ');  // the data starts at a multiple of 64 bytes
    header += '\n';
    std::vector<float> pixels;
    pixels.reserve(size_t(film.width) * film.height * channels);
    for (size_t i = 0; i < size_t(film.width) * film.height; ++i)
        for (const Layer& layer : film.layers)
            pixels.insert(pixels.end(), layer.pixel(i), layer.pixel(i) + layer.channels);
    std::ofstream out(file, std::ios::binary);
    const uint16_t size = uint16_t(header.size());
    out.write("\x93NUMPY\x01\x00", 8);
    out.put(char(size & 255)).put(char(size >> 8));
    out << header;
    out.write(reinterpret_cast<const char*>(pixels.data()), std::streamsize(pixels.size() * sizeof(float)));
    out.close();
    if (!out) throw InfrastructureError(file + ": cannot be written; is the folder there and the disk not full?");
}

}  // namespace

void write_film(const Film& film, const std::filesystem::path& file, double exposure) {
    const std::string extension = file.extension().string();
    if (extension == ".png") {
        for (const Layer& layer : film.layers) {
            std::filesystem::path path = file;
            if (layer.name != "total") path.replace_extension("." + layer.name + ".png");
            write_png(film, layer, path.string(), exposure);
        }
    } else if (extension == ".exr") {
        write_exr(film, file.string());
    } else if (extension == ".npy") {
        write_npy(film, file.string());
    } else {
        throw InputError(file.string() + ": unknown image format; end the name in .png, .exr or .npy");
    }
}

}  // namespace shadelab
