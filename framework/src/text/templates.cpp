#include "text/templates.hpp"

#include <shadelab/error.hpp>

#include <cctype>
#include <fstream>
#include <sstream>
#include <stdexcept>

namespace shadelab {

std::string read_text(const std::filesystem::path& file) {
    std::ifstream in(file);
    std::ostringstream text;
    text << in.rdbuf();
    if (!in) throw InputError(file.string() + ": cannot be read; does the file exist?");
    return text.str();
}

std::string filled(const std::filesystem::path& file, const std::map<std::string, std::string>& words) {
    const std::string text = read_text(file);
    std::string out;
    size_t at = 0;
    for (size_t begin; (begin = text.find('@', at)) != std::string::npos;) {
        const size_t end = text.find('@', begin + 1);
        if (end == std::string::npos) throw std::logic_error(file.string() + ": a gap has no end");
        const std::string name = text.substr(begin + 1, end - begin - 1);
        const auto word = words.find(name);
        if (word == words.end()) throw std::logic_error(file.string() + ": nothing fills the gap " + name);
        out += text.substr(at, begin - at) + word->second;
        at = end + 1;
    }
    return out + text.substr(at);
}

}  // namespace shadelab
