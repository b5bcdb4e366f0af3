// shadelab-render: the one door between the C++ framework and everything else. It draws images, writes frame packets and glue,
// says what it understood of scenes, and evaluates functions over tables. Data goes to files; stdout is what a student's code
// prints, but for `describe`, which runs none, and `frames`, which answers there.

#include "commands.hpp"

#include <shadelab/error.hpp>

#include <iostream>

using namespace shadelab;

int main(int argc, char** argv) {
    CLI::App app{
        "Draws scenes, writes frame packets and glue, and evaluates shading functions. ./shadelab is the comfortable "
        "way in."};
    Framework framework{SHADELAB_FRAMEWORK_DIR};
    app.require_subcommand(1);
    app.add_option("--framework", framework.folder, "the framework's folder (interface.toml, include/, glsl/, glue/)");
    add_image(app, framework);
    add_describe(app, framework);
    add_frames(app, framework);
    add_convert(app);
    add_packet(app, framework);
    add_glue(app, framework);
    add_evaluate(app);
    try {
        app.parse(argc, argv);  // and run
    } catch (const CLI::ParseError& error) {
        if (error.get_exit_code() == 0) return app.exit(error);  // --help
        std::cerr << error.what() << "\n";
        return 2;
    } catch (const InputError& error) {
        std::cerr << error.what() << "\n";
        return 2;
    } catch (const std::bad_alloc&) {
        std::cerr << "out of memory\n";
        return 3;
    } catch (const std::exception& error) {
        std::cerr << error.what() << "\n";
        return 3;
    }
    return 0;
}
