// convert: an image that is an .npy file as .png or .exr: the way back for images of an OpenGL client.

#include "commands.hpp"

#include <shadelab/error.hpp>
#include <shadelab/film.hpp>

#include <cstdio>
#include <fstream>
#include <memory>

namespace shadelab {

namespace {

/// Reads what write_film wrote as .npy (height x width x channels, float32).
Film read_npy(const std::string& file) {
    std::ifstream in(file, std::ios::binary);
    std::string header(10, ' ');
    in.read(header.data(), 10);
    header.resize(10 + (uint8_t(header[8]) | uint8_t(header[9]) << 8));
    in.read(header.data() + 10, std::streamsize(header.size() - 10));
    int height = 0, width = 0, channels = 0;
    const size_t shape = header.find("'shape': (");
    if (!in || shape == std::string::npos || header.find("'<f4'") == std::string::npos ||
        std::sscanf(header.c_str() + shape, "'shape': (%d, %d, %d)", &height, &width, &channels) != 3)
        throw InputError(file + ": is not an image as .npy (height x width x channels, float32)");
    Features features;
    features.term_layers = channels > 3;
    features.geometry_layers = channels > 13;
    Film film(width, height, features, glm::dvec3(0));
    if (film.channel_count() != channels)
        throw InputError(file + ": has " + std::to_string(channels) + " channels, not 3 or all layers");
    for (size_t i = 0; i < size_t(width) * height; ++i)
        for (Layer& layer : film.layers)
            in.read(reinterpret_cast<char*>(layer.pixel(i)), std::streamsize(sizeof(float) * layer.channels));
    if (!in) throw InputError(file + ": ends before its last pixel");
    return film;
}

}  // namespace

void add_convert(CLI::App& app) {
    struct Options {
        std::string input, output;
        double exposure = 0;
    };
    CLI::App* command = app.add_subcommand("convert", "write an image that is an .npy file as .png or .exr");
    const auto options = std::make_shared<Options>();
    command->add_option("input", options->input, "image (.npy)")->required();
    command->add_option("-o,--output", options->output, "FILE.png, .exr or .npy")->required();
    command->add_option("--exposure", options->exposure, "PNG only: times 2^EXPOSURE");
    command->callback([options] { write_film(read_npy(options->input), options->output, options->exposure); });
}

}  // namespace shadelab
